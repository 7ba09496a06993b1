"""The physical figures of each drone platform: one row for each, with the sources of its figures.

Controllers, simulated plants and radios read them.
"""

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.types import Vec

Three = tuple[float, float, float]
"""Three numbers: one for each body axis, or the gains kp, ki, kd."""
LARGEST_AXIS_COMMAND = 32767.0
"""Largest command about an axis that the firmware gives to its motors: the maximum of an int16."""


@dataclass(frozen=True)
class Rotor:
    """One motor with its propeller, as identified by measurement.

        f = thrust[0] r + thrust[1] r^2
        m = torque[0] r + torque[1] r^2
        df/dt = (f_c - f) / lag

    f is the thrust in N, m the torque in N m, r the speed in rpm, f_c the commanded thrust in N.
    """

    thrust: tuple[float, float]
    """Coefficients of the thrust in N over r in rpm."""
    torque: tuple[float, float]
    """Coefficients of the torque in N m over r in rpm."""
    lag: float
    """s: time constant of the thrust."""
    inertia: float
    """kg m2."""
    radius: float
    """m: radius of the propeller."""
    voltage: tuple[float, float, float, float]
    """c0 to c3 of f = c0 + c1 v + c2 v^2 + c3 v^3, f in N, v in V.

    The firmware uses this curve to produce the wanted thrust at any battery voltage.
    """


@dataclass(frozen=True)
class Firmware:
    """What the firmware assumes of its platform: constants that it is compiled with."""

    mass: float
    """kg."""
    arm: float
    """m: from the centre to a motor."""
    thrust_max: float
    """N: thrust of one motor at command 65535."""
    thrust_min: float
    """N: a motor stops below this thrust."""
    thrust_to_torque: float
    """m: torque of a motor over its thrust."""
    needs_arming: bool = False
    """The motors wait for an arming request."""
    rate_pid: Three = (250.0, 500.0, 2.5)
    """Gains kp, ki, kd of the roll and pitch rate loops.

    Units: command units (65535 = thrust_max) over deg/s, deg and deg/s2.
    """
    yaw_rate_pid: Three = (120.0, 16.7, 0.0)
    """Gains kp, ki, kd of the yaw rate loop, in the units of rate_pid."""
    old_thrust_map: float | None = None
    """Command units per newton, all motors together, in releases until 2025.02.

    None: not measured.
    """
    low: float = 3.2
    """V: voltage under load at which the battery is low."""
    critical: float = 3.0
    """V: voltage under load at which the battery is critical."""


@dataclass(frozen=True)
class Battery:
    """One lithium-polymer cell."""

    full: float = 4.2
    """V at rest, charged."""
    empty: float = 3.0
    """V at rest, discharged."""
    resistance: float = 0.12
    """ohm."""
    capacity: float = 0.25 * 3600.0
    """A s."""
    idle: float = 0.12
    """A: current of the electronics."""
    hover_power: float = 7.0
    """W: power that the motors need to carry the drone."""
    begin: float = 3.7
    """V: a drone does not take off below this voltage.

    At this voltage a tenth of the charge is left, by the level table of the firmware, which is the
    same for all platforms.
    """

    @property
    def worn(self) -> "Battery":
        """The battery after many flights, like that of the drone of `BodyEffects`.

        Source: that battery sagged by 0.6 V at take-off, and carried its drone for about 110 s until 3.0 V.
        With these factors a cf21 sags by 0.6 V and hovers for 123 s.
        """
        return replace(
            self,
            resistance=2.0 * self.resistance,
            capacity=0.44 * self.capacity,
            hover_power=1.3 * self.hover_power,
        )


@dataclass(frozen=True)
class BodyEffects:
    """Effects on the body that recorded flights show and a wrench of ideal rotors lacks.

    None is an effect that is not known of a drone: its body has none, or in a swarm file's worlds what
    the table [motors] says is typical.

        tau += (speed_moment[0] a_y, -speed_moment[1] a_x, 0) - rate_damping w

    a is the speed of the drone through the air and w its rates, both in the body frame: the moment
    lifts the side that flies ahead.
    Source: found in 77 flights of a Crazyflie 2.1 (NanoBench, Ullah & Baca, arXiv 2603.09908).
    """

    speed_moment: tuple[float, float] | None = None
    """N m per m/s, about x and y."""
    motor_factors: tuple[float, float, float, float] | None = None
    """Share of the platform's thrust that motors 1 to 4 make at the same command."""
    rate_damping: Three | None = None
    """N m per rad/s, body axes."""
    delay: float | None = None
    """s: time constant of a lag between the commands and the rotors, in series with the rotors' own lag."""

    def filled(self, other: "BodyEffects") -> "BodyEffects":
        """Return these effects, with those of another where they are not known."""
        known = {name: getattr(self, name) for name in EFFECT_NAMES}
        return replace(
            other, **{name: one for name, one in known.items() if one is not None}
        )


EFFECT_NAMES = tuple(field.name for field in fields(BodyEffects))
"""Names of the effects."""
EVEN_MOTORS = (1.0, 1.0, 1.0, 1.0)
"""Factors of motors that do not differ."""


@dataclass(frozen=True)
class Platform:
    """The figures of one kind of drone."""

    name: str
    """Name of the row in the swarm file."""
    mass: float
    """kg."""
    inertia: Three
    """kg m2, about the body axes."""
    arm: float
    """m: from the centre to a motor, along x and along y."""
    drag: Three
    """kg/s, body axes: diagonal of the drag matrix A."""
    max_thrust: float
    """N: all motors together."""
    rotor: Rotor
    """One motor with its propeller."""
    firmware: Firmware
    """Constants of its firmware."""
    source: str
    """Where the figures come from."""
    battery: Battery = Battery()
    """Its battery."""
    max_rate: Three = (10.0, 10.0, 5.0)
    """rad/s, body."""
    max_landing_speed: float = 1.0
    """m/s: a faster touch-down is a crash."""
    radius: float = 0.0685
    """m: radius of a disc around body and propellers."""
    effects: BodyEffects = BodyEffects()
    """What flights show beside the figures above."""

    @property
    def weight(self) -> float:
        """N: weight of the drone."""
        return self.mass * STANDARD_GRAVITY

    @property
    def flat(self) -> Vec:
        """The figures for the kernels, (9,).

        mass, drag (3), max_thrust, max_rate (3), max_landing_speed.
        """
        return np.array(
            [
                self.mass,
                *self.drag,
                self.max_thrust,
                *self.max_rate,
                self.max_landing_speed,
            ]
        )


HOVER_ROTOR_SPEEDS = 4 * 1862.1
"""rad/s: sum of the speeds of four rotors that carry 27 g.

Source: Förster's thrust and speed maps.
"""
IDENTIFICATION_SOURCE = (
    "identified in the drone-models package 0.1.0 (learnsyslab, MIT): mass, inertia, arm, drag, curves and lag of the "
    "rotors; the firmware's constants and voltage curve: crazyflie-firmware, August 2026; rates and landing speed: "
    "chosen; battery: 250 mAh cell, 7 minutes of hovering, resistance chosen"
)
"""Source of the identified platforms."""
FLIGHT_SOURCE = (
    "77 recorded flights of another one, with a worn battery and heavier markers (NanoBench, arXiv 2603.09908), have: "
    "rotors that lag by 60 ms and another 12 ms, drag of 0.0125 kg/s for this mass, 27 % less thrust"
)
"""What recorded flights of a Crazyflie 2.1 say beside its figures."""


@dataclass(frozen=True, slots=True)
class RotorModels:
    """The rotors that were identified by measurement."""

    crazyflie_21: Rotor = Rotor(
        thrust=(-5.382196214637237e-7, 2.4582929831265485e-10),
        torque=(1.410454111996297e-9, 1.4592584373980652e-12),
        lag=0.0858607,
        inertia=34.52e-9,
        radius=0.02355,
        voltage=(-0.0148307, 0.0472447, -0.0184736, 0.00596092),
    )
    """Rotor of the Crazyflie 2.1 with 45 mm propellers and a 250 mAh battery."""
    crazyflie_21_plus: Rotor = Rotor(
        thrust=(-3.6200226530383495e-7, 1.6060924304100328e-10),
        torque=(-2.2665265829562245e-9, 1.1149485566919186e-12),
        lag=0.0578952,
        inertia=26.97e-9,
        radius=0.0234,
        voltage=(-0.0247654, 0.0652379, -0.0267925, 0.00677679),
    )
    """Rotor of the Crazyflie 2.1+ with a 250 mAh battery."""
    thrust_upgrade: Rotor = Rotor(
        thrust=(-7.167227176573658e-7, 2.9401303690194613e-10),
        torque=(5.815894847811497e-10, 1.331813874166509e-12),
        lag=0.05062676,
        inertia=38.93e-9,
        radius=0.0254,
        voltage=(0.00672813, 0.0101156, 0.0102632, 0.00283586),
    )
    """Rotor of the Crazyflie 2.1 with the thrust upgrade and a 350 mAh battery."""
    brushless: Rotor = Rotor(
        thrust=(-3.133427287299859e-7, 4.407354891648379e-10),
        torque=(1.65886356219615e-9, 2.4693477924534137e-12),
        lag=0.02055366,
        inertia=38.93e-9,
        radius=0.0275,
        voltage=(-0.0140589, 0.0426527, 0.00183278, 0.0020577),
    )
    """Rotor of the Crazyflie 2.1 Brushless."""


ROTOR_MODELS = RotorModels()


OLD_THRUST_MAP = 42_000 / 0.39
"""Command units a newton of a bare Crazyflie 2.1, releases until 2025.02.

Source: measured by the authors of CrazyChoir.
"""


@dataclass(frozen=True, slots=True)
class FirmwareModels:
    """What the firmware assumes of each kind of drone."""

    crazyflie_21: Firmware = Firmware(
        mass=0.029,
        arm=0.046,
        thrust_max=0.12,
        thrust_min=0.0128,
        thrust_to_torque=0.00735086,
        old_thrust_map=OLD_THRUST_MAP,
    )
    """Firmware of the Crazyflie 2.0 and 2.1."""
    crazyflie_21_plus: Firmware = Firmware(
        mass=0.029,
        arm=0.046,
        thrust_max=0.12,
        thrust_min=0.0128,
        thrust_to_torque=0.00699289,
    )
    """Firmware of the Crazyflie 2.1+."""
    thrust_upgrade: Firmware = Firmware(
        mass=0.0325,
        arm=0.046,
        thrust_max=0.18,
        thrust_min=0.0192,
        thrust_to_torque=0.00516486,
    )
    """Firmware of the Crazyflie 2.1 with the thrust upgrade."""
    brushless: Firmware = Firmware(
        mass=0.0393,
        arm=0.050,
        thrust_max=0.2,
        thrust_min=0.02136,
        thrust_to_torque=0.00569279,
        needs_arming=True,
        rate_pid=(200.0, 400.0, 2.5),
        low=3.35,
    )
    """Firmware of the Crazyflie 2.1 Brushless."""


FIRMWARE_MODELS = FirmwareModels()


PAPER_PLATFORM = Platform(
    name="paper",
    mass=0.027,
    inertia=(16.571710e-6, 16.655602e-6, 29.261652e-6),
    arm=0.03253,
    drag=(
        9.1785e-7 * HOVER_ROTOR_SPEEDS,
        9.1785e-7 * HOVER_ROTOR_SPEEDS,
        10.311e-7 * HOVER_ROTOR_SPEEDS,
    ),
    max_thrust=0.48,
    rotor=ROTOR_MODELS.crazyflie_21,
    firmware=FIRMWARE_MODELS.crazyflie_21,
    source="mass: the CrazyChoir paper; inertia, and drag per rotor speed, here at the rotor speed of hover: Förster "
    "2015, ETH Zürich; arm and rotors: those of cf21; thrust: 0.12 N a motor, the firmware's limit",
)
CRAZYFLIE_21 = Platform(
    name="cf21",
    mass=0.0319,
    inertia=(16.8e-6, 16.8e-6, 29.8e-6),
    arm=0.03253,
    drag=(0.01471782, 0.01471782, 0.01277641),
    max_thrust=0.48,
    rotor=ROTOR_MODELS.crazyflie_21,
    firmware=FIRMWARE_MODELS.crazyflie_21,
    source=f"Crazyflie 2.1 with 45 mm propellers and markers; {IDENTIFICATION_SOURCE}; {FLIGHT_SOURCE}",
)
CRAZYFLIE_21_PLUS = Platform(
    name="cf21plus",
    mass=0.0318,
    inertia=(16.8e-6, 16.8e-6, 29.8e-6),
    arm=0.03253,
    drag=(0.01351483, 0.01351483, 0.01677452),
    max_thrust=0.48,
    rotor=ROTOR_MODELS.crazyflie_21_plus,
    firmware=FIRMWARE_MODELS.crazyflie_21_plus,
    source=f"Crazyflie 2.1+ with markers; {IDENTIFICATION_SOURCE} (inertia: that of cf21)",
)
CRAZYFLIE_21_THRUST = Platform(
    name="cf21thrust",
    mass=0.0379,
    inertia=(16.8e-6, 16.8e-6, 29.8e-6),
    arm=0.03253,
    drag=(0.01556697, 0.01556697, 0.02191672),
    max_thrust=0.72,
    rotor=ROTOR_MODELS.thrust_upgrade,
    firmware=FIRMWARE_MODELS.thrust_upgrade,
    source=(
        "Crazyflie 2.1 with the thrust upgrade and a 350 mAh battery; "
        f"{IDENTIFICATION_SOURCE} (inertia: that of cf21)"
    ),
    battery=Battery(capacity=0.35 * 3600.0, hover_power=9.0),
)
CRAZYFLIE_21_BRUSHLESS = Platform(
    name="cf21bl",
    mass=0.04338,
    inertia=(25e-6, 28e-6, 49e-6),
    arm=0.035355,
    drag=(0.02149163, 0.02149163, 0.02359736),
    max_thrust=0.8,
    rotor=ROTOR_MODELS.brushless,
    firmware=FIRMWARE_MODELS.brushless,
    source=f"Crazyflie 2.1 Brushless with markers; {IDENTIFICATION_SOURCE}",
    battery=Battery(capacity=0.35 * 3600.0, hover_power=9.0),
    radius=0.078,
)
PLATFORM_BY_NAME = {
    row.name: row
    for row in (
        PAPER_PLATFORM,
        CRAZYFLIE_21,
        CRAZYFLIE_21_PLUS,
        CRAZYFLIE_21_THRUST,
        CRAZYFLIE_21_BRUSHLESS,
    )
}
"""All platforms by name. The swarm file names one with `find_platform`."""


def find_platform(name: str, where: str = "platform") -> Platform:
    """Return the platform of this name.

    where: the key that holds the name, for the error.
    Raises ConfigError with all names if there is no such platform.
    """
    if name not in PLATFORM_BY_NAME:
        raise ConfigError(where, name, f"one of {', '.join(PLATFORM_BY_NAME)}")
    return PLATFORM_BY_NAME[name]


def rotor_speed(rotor: Rotor, f: float) -> float:
    """Return the speed in rpm at which one rotor makes the thrust f.

    It is the positive root of the thrust curve of the rotor.

    f: N: wanted thrust; the speed is 0 for f <= 0.
    """
    b, c = rotor.thrust
    return 0.0 if f <= 0.0 else (-b + math.sqrt(b * b + 4.0 * c * f)) / (2.0 * c)


def find_equivalent_platform(platform: Platform, factor: float) -> Platform:
    """Return a platform that obeys the thrust u exactly and moves like a drone that makes k u of it.

        m v' = -m g e3 + k u R e3 - R A R^T v      has the solutions of m/k, A/k, u
        J w' = k l S u + M v - D w, about x and y  has the solutions of J/k, M/k, D/k, u

    The drag of rotors that turn as fast stays, and so does all about z. The power of a hover is that of the thrust
    m g/k, to the power of 1.5.

    platform: figures of the drone without its factor
    factor: k, true thrust over the thrust that is commanded
    """
    k = factor
    drag_x, drag_y, drag_z = platform.drag
    inertia_x, inertia_y, inertia_z = platform.inertia
    moment = platform.effects.speed_moment
    damping = platform.effects.rate_damping
    battery = platform.battery
    return replace(
        platform,
        mass=platform.mass / k,
        inertia=(inertia_x / k, inertia_y / k, inertia_z),
        drag=(drag_x / k, drag_y / k, drag_z / k),
        battery=replace(battery, hover_power=battery.hover_power * k**-1.5),
        effects=replace(
            platform.effects,
            speed_moment=moment and (moment[0] / k, moment[1] / k),
            rate_damping=damping and (damping[0] / k, damping[1] / k, damping[2]),
        ),
    )
