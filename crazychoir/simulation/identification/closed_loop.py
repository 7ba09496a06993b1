"""Fly recorded set-points again, with the simulated firmware, sensors and body in closed loop."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import Platform
from crazychoir.simulation.common.mismatch import apply_model_errors
from crazychoir.simulation.identification.flights import (
    FLIGHT_RULES,
    FLIGHT_TIME_STEP,
    RealFlight,
)
from crazychoir.simulation.identification.open_loop import (
    TrimSource,
    estimate_trims,
    follow_plant,
)
from crazychoir.simulation.identification.parameters import (
    PHYSICAL_PARAMETERS,
)
from crazychoir.simulation.identification.windows import find_windows
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.motor_level.disturbances import Disturbances
from crazychoir.simulation.motor_level.imu import VIBRATING_IMU
from crazychoir.simulation.motor_level.motors import MotorConditions
from crazychoir.simulation.motor_level.pose_delay import PoseDelay
from crazychoir.simulation.onboard.record import CONTROLLER_KINDS
from crazychoir.types import Mat, Vec


class ClosedLoopRules(NamedTuple):
    """What is not recorded of a flight, and assumed in its simulation."""

    disturbances: Disturbances = Disturbances(torque=3.0, force=0.07)
    """Slow torques and forces."""
    position_noise: float = 0.0001
    """m: standard deviation of a pose, for each axis."""
    angle_noise: float = 0.00175
    """rad: standard deviation of its attitude, for each axis."""
    pose_latency: float = 0.04
    """s: mean age of a pose when the estimator on board takes it; recorded estimates are 15 to 50 ms late."""
    pose_jitter: float = 0.01
    """s: largest difference of that age from its mean."""
    pose_deviation: float = 0.0025
    """m: deviation that the estimator on board expects of a pose.

    It is not recorded. With this value the estimated velocities are 6 % too large, as the recorded
    ones (5 to 8 %), because the estimator knows no drag; with the firmware's default of 0.01 m they
    are 12 % too large.
    """
    compensation: float = 1.075
    """Thrust over the requested one, by the thrust over the voltage at the motors.

    The recorded firmware assumes another curve of the thrust over the voltage than `platforms` has.
    In all flights with recorded requests the factor is 1.065 to 1.079.
    """
    saturated_duty: float = 0.98
    """Duty cycle from which a motor is at its limit."""


CLOSED_LOOP_RULES = ClosedLoopRules()


@dataclass(frozen=True, slots=True)
class FlownAgain:
    """A recorded flight and its simulation."""

    flight: RealFlight
    """The recorded flight, n rows."""
    setpoints: Mat
    """(n, 4) m, rad: its set-points."""
    states: Mat
    """(n, 13): simulated states; before the first set-point the drone stands on the floor."""


def fly_again(
    flights: Sequence[RealFlight], platform: Platform, seed: int = 0
) -> list[FlownAgain]:
    """Fly the recorded set-points of each flight with a simulated drone.

    Its body has the physical set of parameters, and the thrust and the imbalance of the motors of
    that flight. Its firmware is that of the platform, with the PID controller where a thrust request
    is recorded, else with Mellinger's.

    Raises ConfigError if a flight has no set-points.
    """
    for flight in flights:
        if flight.setpoints is None:
            raise ConfigError(
                flight.name,
                "no set-points",
                "sp and sp_yaw: what the firmware followed",
            )
    if not flights:
        return []
    bodies = [find_body(flight, platform) for flight in flights]
    starts = [_find_first_setpoint(flight) for flight in flights]
    world = _make_world(flights, starts, platform, bodies, seed)
    noise = np.random.default_rng(seed)
    rows = [len(flight.t) for flight in flights]
    seen = np.ones(len(flights), bool)
    simulated = np.empty((max(rows), len(flights), 13))
    for row in range(max(rows)):
        simulated[row] = world.states
        world.see_frame(_measure_poses(world.states, noise), seen)
        for drone, flight in enumerate(flights):
            if flight.setpoints is not None and starts[drone] <= row < rows[drone]:
                x, y, z, yaw = flight.setpoints[row]
                world.onboard[drone].setpoints.position((x, y, z), yaw)
        world.step()
    return [
        FlownAgain(flight, flight.setpoints, simulated[: rows[drone], drone])
        for drone, flight in enumerate(flights)
        if flight.setpoints is not None
    ]


def _measure_poses(states: Mat, noise: np.random.Generator) -> Mat:
    """Return the poses (n, 7) of states (n, 13) as motion capture measures them."""
    turned = Rotation.from_quat(states[:, 6:10]) * Rotation.from_rotvec(
        noise.normal(scale=CLOSED_LOOP_RULES.angle_noise, size=(len(states), 3))
    )
    places = states[:, :3] + noise.normal(
        scale=CLOSED_LOOP_RULES.position_noise, size=(len(states), 3)
    )
    return np.hstack([places, turned.as_quat()])


def find_body(flight: RealFlight, platform: Platform) -> Platform:
    """Return the body of a flight: the physical set, with the flight's own thrust and imbalance."""
    windows = find_windows([flight])
    parameters = PHYSICAL_PARAMETERS
    plant = follow_plant(windows, parameters.apply(platform))
    trims = estimate_trims(windows, plant, TrimSource.LAST)
    factor = _find_thrust_factor(flight, platform)
    if factor is None:
        factor = CLOSED_LOOP_RULES.compensation * float(np.median(trims.thrust))
    body = apply_model_errors(
        replace(parameters.apply(platform), firmware=platform.firmware),
        0.0,
        factor - 1.0,
    )
    factors = _find_motor_factors(body, np.median(trims.offsets, axis=0))
    return replace(
        body,
        effects=replace(body.effects, motor_factors=factors),
        battery=platform.battery.worn,
    )


def _find_thrust_factor(flight: RealFlight, platform: Platform) -> float | None:
    """Return the thrust over the requested one, None without requests.

    It is the ratio of two means: mass times specific force along the thrust axis, and four times the
    thrust that was requested of a motor, in the air, outside of gaps and with no motor at its limit.
    """
    if flight.request is None:
        return None
    a, b = flight.airborne
    counted = flight.is_known & (
        flight.duty.max(axis=1) < CLOSED_LOOP_RULES.saturated_duty
    )
    counted[:a] = False
    counted[b:] = False
    acceleration = savgol_filter(
        flight.p,
        FLIGHT_RULES.smoothing_rows,
        3,
        deriv=2,
        delta=FLIGHT_TIME_STEP,
        axis=0,
    )
    acceleration[:, 2] += STANDARD_GRAVITY
    force = Rotation.from_quat(flight.q).inv().apply(acceleration)[:, 2]
    requested = 4.0 * platform.firmware.thrust_max * flight.request[counted].mean()
    return float(platform.mass * force[counted].mean() / requested)


def _find_motor_factors(
    body: Platform, offsets: Vec
) -> tuple[float, float, float, float]:
    """Return the factors of motors 1 to 4 that turn a hovering body as the offsets.

    offsets: (3,) rad/s2, body: angular acceleration; that about z is left to the controller
    """
    torque = 4.0 * body.arm * 0.25 * body.weight
    roll = float(offsets[0]) * body.inertia[0] / torque
    pitch = float(offsets[1]) * body.inertia[1] / torque
    return (
        1.0 - roll - pitch,
        1.0 - roll + pitch,
        1.0 + roll + pitch,
        1.0 + roll - pitch,
    )


def _find_first_setpoint(flight: RealFlight) -> int:
    """Return the row at which the set-point moves for the first time."""
    if flight.setpoints is None:
        return 0
    moved = np.any(flight.setpoints != flight.setpoints[0], axis=1)
    return int(np.argmax(moved))


def _make_world(
    flights: Sequence[RealFlight],
    starts: Sequence[int],
    platform: Platform,
    bodies: Sequence[Platform],
    seed: int,
) -> CrazyflieWorld:
    """Return a world in which each flight has a drone at its start, which feels no other drone."""
    places = np.array(
        [flight.p[row] for flight, row in zip(flights, starts, strict=True)]
    )
    places[:, 2] = 0.0
    turns = [
        Rotation.from_quat(flight.q[row]).as_euler("ZYX")[0]
        for flight, row in zip(flights, starts, strict=True)
    ]
    rules = CLOSED_LOOP_RULES
    world = CrazyflieWorld(
        range(len(flights)),
        places,
        np.array(turns),
        platform,
        bodies=bodies,
        pose_delay=PoseDelay(
            rules.pose_latency, rules.pose_jitter, seed, FLIGHT_TIME_STEP
        ),
        seed=seed,
        conditions=MotorConditions(
            imu=VIBRATING_IMU, disturbances=rules.disturbances, has_downwash=False
        ),
    )
    for drone, flight in enumerate(flights):
        world.link(drone, "xyz")
        onboard = world.onboard[drone]
        onboard.arm()
        onboard.set("locSrv.extPosStdDev", rules.pose_deviation)
        if flight.request is None:
            onboard.set("stabilizer.controller", CONTROLLER_KINDS.mellinger)
    return world
