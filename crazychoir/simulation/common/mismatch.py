"""Bodies that differ from what their controllers assume: heavier, or with stronger rotors."""

from dataclasses import replace

from crazychoir.platforms import Platform, find_equivalent_platform


def apply_model_errors(
    platform: Platform, mass_error: float, thrust_error: float
) -> Platform:
    """Return the true platform of a drone with rotors, which gets unchanged motor commands.

        m = (1 + e_m) m_0,   f(r) = (1 + e_f) f_0(r),   P(r) = P_0(r)

    A motor turns at its usual speed, but its propeller pulls harder. Therefore every quantity that
    maps a command to a thrust is scaled: the curves of the rotor over speed and over voltage, and
    both ends of the firmware's thrust scale.
    mass_error: e_m, relative error of the mass, above -1
    thrust_error: e_f, relative error of the thrust, above -1
    r: speed of a rotor
    P: power that the battery gives for a rotor, proportional to f^1.5
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


def find_lightweight_platform(
    platform: Platform, mass_error: float, thrust_error: float
) -> Platform:
    """Return the true platform of a drone without rotors: its model makes the thrust that is commanded.

    mass_error: e_m, relative error of the mass in m = (1 + e_m) m_0, above -1
    thrust_error: e_f, relative error of the thrust, above -1
    """
    heavier = replace(platform, mass=(1.0 + mass_error) * platform.mass)
    return find_equivalent_platform(heavier, 1.0 + thrust_error)
