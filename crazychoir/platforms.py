"""What a drone is made of: one row a platform, every figure with its source; for controllers, plants and radios."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import GRAVITY
from crazychoir.types import Vec

Three = tuple[float, float, float]
MOST_TURN = 32767.0
"""The largest command about an axis that the firmware gives to its motors, an int16."""


@dataclass(frozen=True)
class Rotor:
    """One motor with its propeller, as it is identified.

        f = thrust[0] r + thrust[1] r^2,   m = torque[0] r + torque[1] r^2,   df/dt = (f_c - f) / lag

    thrust: N of r in rpm;  torque: N m;  lag: s, of the thrust;  inertia: kg m2;  radius: m, of the propeller;
    voltage: c0 to c3 of f = c0 + c1 v + c2 v^2 + c3 v^3, v in V: how the firmware makes a thrust at any battery.
    """

    thrust: tuple[float, float]
    torque: tuple[float, float]
    lag: float
    inertia: float
    radius: float
    voltage: tuple[float, float, float, float]


@dataclass(frozen=True)
class Firmware:
    """What the firmware assumes of its platform: constants that it is compiled with.

    mass: kg;  arm: m, from the centre to a motor;  thrust_max, thrust_min: N a motor, of command 65535 and below which
    a motor stops;  thrust_to_torque: m;  needs_arming: whether motors wait for an arming request;
    rate_pid, yaw_rate_pid: kp, ki, kd of the rate loops, command units (65535 = thrust_max) of deg/s, deg, deg/s2;
    old_thrust_map: command a newton, all motors, of releases until 2025.02, None: not measured;
    low, critical: V, of its battery under load.
    """

    mass: float
    arm: float
    thrust_max: float
    thrust_min: float
    thrust_to_torque: float
    needs_arming: bool = False
    rate_pid: Three = (250.0, 500.0, 2.5)
    yaw_rate_pid: Three = (120.0, 16.7, 0.0)
    old_thrust_map: float | None = None
    low: float = 3.2
    critical: float = 3.0


@dataclass(frozen=True)
class Battery:
    """One lithium-polymer cell.

    full, empty: V at rest;  resistance: ohm;  capacity: A s;  idle: A, of the electronics;
    hover_power: W, that the motors take to carry the drone;  begin: V, with less nobody takes off: a tenth is left, by
    the level table of the firmware, which is one for all.
    """

    full: float = 4.2
    empty: float = 3.0
    resistance: float = 0.12
    capacity: float = 0.25 * 3600.0
    idle: float = 0.12
    hover_power: float = 7.0
    begin: float = 3.7


@dataclass(frozen=True)
class Platform:
    """Figures of one kind of drone.

    mass: kg;  inertia: kg m2, about the body axes;  arm: m, from the centre to a motor along x and along y;
    drag: diagonal of A, kg/s, body axes;  max_thrust: N, all motors;  max_rate: rad/s, body;
    max_landing_speed: m/s, a faster touch-down is a crash;  radius: m, of a disc around body and propellers;
    source: where the figures come from.
    """

    name: str
    mass: float
    inertia: Three
    arm: float
    drag: Three
    max_thrust: float
    rotor: Rotor
    firmware: Firmware
    source: str
    battery: Battery = Battery()
    max_rate: Three = (10.0, 10.0, 5.0)
    max_landing_speed: float = 1.0
    radius: float = 0.0685

    @property
    def weight(self) -> float:
        """N."""
        return self.mass * GRAVITY

    @property
    def flat(self) -> Vec:
        """(9,) for the kernels: mass, drag (3), max_thrust, max_rate (3), max_landing_speed."""
        return np.array(
            [
                self.mass,
                *self.drag,
                self.max_thrust,
                *self.max_rate,
                self.max_landing_speed,
            ]
        )


HOVER_ROTOR_SPEEDS = (
    4 * 1862.1
)  # rad/s, sum of four rotors carrying 27 g: Förster's thrust and speed maps
IDENTIFIED = (
    "identified in the drone-models package 0.1.0 (learnsyslab, MIT): mass, inertia, arm, drag, curves and lag of the "
    "rotors; the firmware's constants and voltage curve: crazyflie-firmware, August 2026; rates and landing speed: "
    "chosen; battery: 250 mAh cell, 7 minutes of hovering, resistance chosen"
)

L250 = Rotor(
    thrust=(-5.382196214637237e-7, 2.4582929831265485e-10),
    torque=(1.410454111996297e-9, 1.4592584373980652e-12),
    lag=0.0858607,
    inertia=34.52e-9,
    radius=0.02355,
    voltage=(-0.0148307, 0.0472447, -0.0184736, 0.00596092),
)
P250 = Rotor(
    thrust=(-3.6200226530383495e-7, 1.6060924304100328e-10),
    torque=(-2.2665265829562245e-9, 1.1149485566919186e-12),
    lag=0.0578952,
    inertia=26.97e-9,
    radius=0.0234,
    voltage=(-0.0247654, 0.0652379, -0.0267925, 0.00677679),
)
T350 = Rotor(
    thrust=(-7.167227176573658e-7, 2.9401303690194613e-10),
    torque=(5.815894847811497e-10, 1.331813874166509e-12),
    lag=0.05062676,
    inertia=38.93e-9,
    radius=0.0254,
    voltage=(0.00672813, 0.0101156, 0.0102632, 0.00283586),
)
B500 = Rotor(
    thrust=(-3.133427287299859e-7, 4.407354891648379e-10),
    torque=(1.65886356219615e-9, 2.4693477924534137e-12),
    lag=0.02055366,
    inertia=38.93e-9,
    radius=0.0275,
    voltage=(-0.0140589, 0.0426527, 0.00183278, 0.0020577),
)

OLD_THRUST_MAP = (
    42_000 / 0.39
)  # of a bare Crazyflie 2.1: measured by the authors of CrazyChoir
CF20 = Firmware(
    mass=0.029,
    arm=0.046,
    thrust_max=0.12,
    thrust_min=0.0128,
    thrust_to_torque=0.00735086,
    old_thrust_map=OLD_THRUST_MAP,
)
CF21_PLUS = Firmware(
    mass=0.029,
    arm=0.046,
    thrust_max=0.12,
    thrust_min=0.0128,
    thrust_to_torque=0.00699289,
)
CF21_THRUST = Firmware(
    mass=0.0325,
    arm=0.046,
    thrust_max=0.18,
    thrust_min=0.0192,
    thrust_to_torque=0.00516486,
)
CF21_BRUSHLESS = Firmware(
    mass=0.0393,
    arm=0.050,
    thrust_max=0.2,
    thrust_min=0.02136,
    thrust_to_torque=0.00569279,
    needs_arming=True,
    rate_pid=(200.0, 400.0, 2.5),
    low=3.35,
)

PAPER = Platform(
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
    rotor=L250,
    firmware=CF20,
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
    rotor=L250,
    firmware=CF20,
    source=f"Crazyflie 2.1 with 45 mm propellers and markers; {IDENTIFIED}",
)
CRAZYFLIE_21_PLUS = Platform(
    name="cf21plus",
    mass=0.0318,
    inertia=(16.8e-6, 16.8e-6, 29.8e-6),
    arm=0.03253,
    drag=(0.01351483, 0.01351483, 0.01677452),
    max_thrust=0.48,
    rotor=P250,
    firmware=CF21_PLUS,
    source=f"Crazyflie 2.1+ with markers; {IDENTIFIED} (inertia: that of cf21)",
)
CRAZYFLIE_21_THRUST = Platform(
    name="cf21thrust",
    mass=0.0379,
    inertia=(16.8e-6, 16.8e-6, 29.8e-6),
    arm=0.03253,
    drag=(0.01556697, 0.01556697, 0.02191672),
    max_thrust=0.72,
    rotor=T350,
    firmware=CF21_THRUST,
    source=f"Crazyflie 2.1 with the thrust upgrade and a 350 mAh battery; {IDENTIFIED} (inertia: that of cf21)",
    battery=Battery(capacity=0.35 * 3600.0, hover_power=9.0),
)
CRAZYFLIE_21_BRUSHLESS = Platform(
    name="cf21bl",
    mass=0.04338,
    inertia=(25e-6, 28e-6, 49e-6),
    arm=0.035355,
    drag=(0.02149163, 0.02149163, 0.02359736),
    max_thrust=0.8,
    rotor=B500,
    firmware=CF21_BRUSHLESS,
    source=f"Crazyflie 2.1 Brushless with markers; {IDENTIFIED}",
    battery=Battery(capacity=0.35 * 3600.0, hover_power=9.0),
    radius=0.078,
)
PLATFORMS = {
    row.name: row
    for row in (
        PAPER,
        CRAZYFLIE_21,
        CRAZYFLIE_21_PLUS,
        CRAZYFLIE_21_THRUST,
        CRAZYFLIE_21_BRUSHLESS,
    )
}
"""The table, by name; the swarm file names a row with `platform`."""


def platform(name: str, where: str = "platform") -> Platform:
    """The row of this name; ConfigError names those that there are."""
    if name not in PLATFORMS:
        raise ConfigError(where, name, f"one of {', '.join(PLATFORMS)}")
    return PLATFORMS[name]


def rotor_speed(rotor: Rotor, f: float) -> float:
    """rpm, at which one rotor makes the thrust f in N: the positive root of its curve; 0 for f <= 0."""
    b, c = rotor.thrust
    return 0.0 if f <= 0.0 else (-b + math.sqrt(b * b + 4.0 * c * f)) / (2.0 * c)
