"""Bodies that are not what their controllers believe: heavier than their platform, or with stronger rotors."""

from dataclasses import replace

from crazychoir.platforms import Platform


def built(platform: Platform, mass_error: float, thrust_error: float) -> Platform:
    """The body of a drone with rotors, for the same commands of its firmware.

        m = (1 + e_m) m_0,   f(r) = (1 + e_f) f_0(r),   P(r) = P_0(r)

    A motor turns as fast as it would; its propeller pulls harder. So all that says which thrust a command makes grows:
    the curves of the rotor over speed and over voltage, and the ends of the firmware's scale.
    e_m, e_f: shares, above -1;  r: of a rotor;  P: what the battery gives for it, which goes with f^1.5.
    """
    m = 1.0 + mass_error
    f = 1.0 + thrust_error
    rotor = platform.rotor
    firmware = platform.firmware
    battery = platform.battery
    c1, c2 = rotor.thrust
    v0, v1, v2, v3 = rotor.voltage
    return replace(
        platform,
        mass=m * platform.mass,
        max_thrust=f * platform.max_thrust,
        rotor=replace(
            rotor, thrust=(f * c1, f * c2), voltage=(f * v0, f * v1, f * v2, f * v3)
        ),
        firmware=replace(
            firmware,
            thrust_max=f * firmware.thrust_max,
            thrust_min=f * firmware.thrust_min,
        ),
        battery=replace(battery, hover_power=battery.hover_power * (m / f) ** 1.5),
    )


def scaled(platform: Platform, mass_error: float, thrust_error: float) -> Platform:
    """The body of a drone that makes the thrust u it is told, and flies as one that makes (1 + e_f) u.

        m v' = -m g e3 + (1 + e_f) u R e3 - R A R^T v   has the solutions of   m/(1 + e_f), A/(1 + e_f), u

    m = (1 + e_m) m_0;  e_m, e_f: shares, above -1.
    """
    f = 1.0 + thrust_error
    ax, ay, az = platform.drag
    return replace(
        platform,
        mass=(1.0 + mass_error) * platform.mass / f,
        drag=(ax / f, ay / f, az / f),
    )
