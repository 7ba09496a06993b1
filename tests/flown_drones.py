"""Recordings of simulated Crazyflies with random bodies, in the form of the real flights."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import CRAZYFLIE_21, BodyEffects
from crazychoir.simulation.common.mismatch import apply_model_errors
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.motor_level.motors import MotorConditions

ROW_TIME = 0.01  # s
STANDING_TIME = 1.5  # s on the floor before the first set-point
POSITION_NOISE = 1e-4  # m
ANGLE_NOISE = np.radians(0.1)  # rad
TORQUE_DISTURBANCE = np.array([3.0, 3.0, 1.0])  # rad/s2 rms
FORCE_DISTURBANCE = 0.05  # m/s2 rms
DISTURBANCE_TIME = 0.5  # s
VOLTAGE_ROWS = 10  # rows between two samples of the battery


@dataclass(frozen=True)
class FlownDrone:
    """A drone with what a calibration should find."""

    body: object
    """Its true platform."""
    trim: np.ndarray
    """(2,) rad: roll and pitch of its markers."""
    truth: dict
    """True values by the names of PARAMETER_RULES."""


def draw_drone(draw):
    """Return a drone with random parameters around those of a Crazyflie 2.1."""
    row = CRAZYFLIE_21
    thrust = draw.uniform(0.8, 1.1)
    inertia = np.array(row.inertia) / draw.uniform(0.85, 1.1)
    factors = 1.0 + draw.uniform(-0.06, 0.06, 4)
    factors /= factors.mean()
    moment = np.array(row.inertia[:2]) * draw.uniform(15.0, 40.0, 2)
    damping = inertia * draw.uniform(1.0, 6.0)
    drag = row.mass * draw.uniform(0.3, 0.5, 3)
    lag = draw.uniform(0.04, 0.09)
    delay = draw.choice([0.0, draw.uniform(0.0, 0.02)])
    trim = np.radians(draw.uniform(-1.5, 1.5, 2))
    stronger = apply_model_errors(row, 0.0, thrust - 1.0)
    body = replace(
        stronger,
        rotor=replace(stronger.rotor, lag=lag),
        inertia=tuple(inertia),
        drag=tuple(drag),
        effects=BodyEffects(
            speed_moment=tuple(moment),
            motor_factors=tuple(factors),
            rate_damping=tuple(damping),
            delay=delay,
        ),
        battery=replace(
            stronger.battery,
            resistance=draw.uniform(0.1, 0.25),
            capacity=draw.uniform(450.0, 900.0),
        ),
    )
    lever = row.arm * row.weight / 4.0
    truth = {
        "thrust_factor": thrust,
        "trim_roll": trim[0],
        "trim_pitch": trim[1],
        "drag_x": drag[0],
        "drag_y": drag[1],
        "rotor_lag": lag,
        "moment_roll": moment[0],
        "moment_pitch": moment[1],
        "imbalance_roll": lever * (factors @ [-1, -1, 1, 1]),
        "imbalance_pitch": lever * (factors @ [-1, 1, 1, -1]),
        "battery_resistance": body.battery.resistance,
    }
    return FlownDrone(body, trim, truth)


def excite(t):
    """Return place, velocity and acceleration at t s: take-off, eights, steps, shaking, circles.

    Velocity and acceleration are None where only a place is commanded.
    """
    if t < 4.0:
        return np.array([0.0, 0.0, 1.0]), None, None
    if t < 24.0:
        return fly_eight(t - 4.0)
    if t < 42.0:
        draw = np.random.default_rng(1000 + int((t - 24.0) / 1.5))
        return np.array([*draw.uniform(-0.6, 0.6, 2), 1.0]), None, None
    if t < 52.0:
        draw = np.random.default_rng(2000 + int(t - 42.0))
        return np.array([0.0, 0.0, 1.0 + draw.uniform(-0.4, 0.4)]), None, None
    if t < 64.0:
        return shake_height(t - 52.0)
    w = 2.0 * np.pi / 3.5
    s = w * (t - 64.0)
    r = min(1.0, (t - 64.0) / 3.0)
    p = np.array([r * np.cos(s), r * np.sin(s), 1.0])
    return p, w * np.array([-p[1], p[0], 0.0]), -(w**2) * np.array([p[0], p[1], 0.0])


def fly_eight(s):
    w = 2.0 * np.pi / 5.0
    grown = min(1.0, s / 3.0)
    sizes = grown * np.array([1.0, 0.6, 0.2])
    rates = w * np.array([1.0, 2.0, 0.7])
    p = sizes * np.sin(rates * s) + [0.0, 0.0, 1.0]
    return p, sizes * rates * np.cos(rates * s), -sizes * rates**2 * np.sin(rates * s)


def shake_height(s):
    p, v, a = np.array([0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3)
    for n, hertz in enumerate((0.5, 0.9, 1.6, 2.3, 3.1)):
        w = 2.0 * np.pi * hertz
        size = (1.0 if n == 0 else 1.5) / w**2
        p[2] += size * (np.sin(w * s + 1.7 * n) - np.sin(1.7 * n))
        v[2] += size * w * np.cos(w * s + 1.7 * n)
        a[2] -= size * w**2 * np.sin(w * s + 1.7 * n)
    return p, v, a


def fly(drones, seconds=90.0, plan=excite, seed=7):
    """Fly the drones beside each other without downwash; return the columns of their recordings."""
    count = len(drones)
    draw = np.random.default_rng(seed)
    bodies = [drone.body for drone in drones]
    world = CrazyflieWorld(
        range(count),
        np.zeros((count, 3)),
        bodies=bodies,
        seed=seed,
        conditions=MotorConditions(has_downwash=False),
    )
    inertia = np.array([body.inertia for body in bodies])
    mass = np.array([body.mass for body in bodies])
    decay = np.exp(-ROW_TIME / DISTURBANCE_TIME)
    kick = np.sqrt(1.0 - decay**2) * np.array(
        [*TORQUE_DISTURBANCE, *[FORCE_DISTURBANCE] * 3]
    )
    pushed = np.zeros((count, 6))
    rows = round((seconds + STANDING_TIME) / ROW_TIME)
    columns = [
        {
            "t": ROW_TIME * np.arange(rows),
            **{name: np.empty((rows, 3)) for name in ("p", "gyro", "acc", "sp")},
            **{name: np.empty((rows, 4)) for name in ("q", "duty")},
            "vbat": np.empty(rows),
        }
        for _ in drones
    ]
    for row in range(rows):
        t = row * ROW_TIME - STANDING_TIME
        p, v, a = excite(t) if plan is excite else plan(t)
        pushed = decay * pushed + kick * draw.normal(size=pushed.shape)
        world.torque[:] = pushed[:, :3] * inertia * (t > 0.5)
        world.force[:] = pushed[:, 3:] * mass[:, None] * (t > 0.5)
        for i, onboard in world.onboard.items():
            record = onboard.record
            state = world.states[i]
            seen = state[:3] + POSITION_NOISE * draw.normal(size=3)
            kept = columns[i]
            kept["p"][row] = seen
            kept["q"][row] = state[6:10]
            kept["gyro"][row] = onboard.gyro
            kept["acc"][row] = [record["ax"], record["ay"], record["az"]]
            kept["duty"][row] = record["ratio"] / 65535.0
            kept["vbat"][row] = record["vbat"]
            kept["sp"][row] = p if t >= 0.0 else 0.0
            onboard.external_pose(seen, state[6:10])
            if t < 0.0:
                continue
            if v is None:
                onboard.setpoints.position(p, 0.0)
            else:
                onboard.setpoints.full_state(
                    np.array([*p, *v, *a, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
                )
        world.step()
    for drone, kept in zip(drones, columns, strict=True):
        kept["acc"] *= STANDARD_GRAVITY
        kept["vbat"] = np.repeat(kept["vbat"][::VOLTAGE_ROWS], VOLTAGE_ROWS)[:rows]
        roll, pitch = drone.trim
        tilt = Rotation.from_euler("y", pitch) * Rotation.from_euler("x", roll)
        noise = Rotation.from_rotvec(ANGLE_NOISE * draw.normal(size=(rows, 3)))
        kept["q"] = (Rotation.from_quat(kept["q"]) * tilt * noise).as_quat()
    return columns
