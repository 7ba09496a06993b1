"""The motor-level world: rotors, bodies, air, batteries and inertial sensors at 1 kHz.

All drones advance in one compiled pass a step.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.kernels import kernel, matrix, memory, table, vector
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    Triple,
    quaternion_product,
    rotation,
    rotation_exponential,
)
from crazychoir.platforms import CRAZYFLIE_21, Platform
from crazychoir.simulation.common.draws import (
    RANDOM_STREAMS,
    Keys,
    derive_stream_key,
    draw_uniform,
)
from crazychoir.simulation.common.truth import Truth
from crazychoir.simulation.motor_level.air import (
    Wind,
    advance_block_wind,
    compute_downwash,
)
from crazychoir.simulation.motor_level.battery import drain_batteries
from crazychoir.simulation.motor_level.body import integrate_bodies, set_goal_thrusts
from crazychoir.simulation.motor_level.disturbances import (
    Disturbances,
    DisturbedWrenches,
    ExternalWrenches,
)
from crazychoir.simulation.motor_level.floor import apply_floor
from crazychoir.simulation.motor_level.imu import Imu, measure_block
from crazychoir.types import Mat, Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    ACCELEROMETER_X,
    ACCELEROMETER_Y,
    ACCELEROMETER_Z,
    WIND_X,
    WIND_Y,
    WIND_Z,
    MOTOR_ALIVE_1,
    MOTOR_ALIVE_2,
    MOTOR_ALIVE_3,
    MOTOR_ALIVE_4,
    GOAL_THRUST_1,
    GYROSCOPE_BIAS_X,
    BATTERY_CHARGE,
    ROTOR_THRUST_1,
    AIRBORNE_FLAG,
    IMPACT_SPEED,
    GYROSCOPE_X,
    GYROSCOPE_Y,
    GYROSCOPE_Z,
    LANE_COUNT,
    TOTAL_LIFT,
    STAGE_THRUST_1,
    THRUST_SLOPE_1,
    BLOCK_SIZE,
    SPECIFIC_FORCE_X,
    MOTOR_COMMAND_1,
    MOTOR_COMMAND_2,
    MOTOR_COMMAND_3,
    MOTOR_COMMAND_4,
    BATTERY_VOLTAGE,
    Blocks,
    block_fields,
    blocks,
    compute_constants,
    store_block,
    arrange_in_lanes,
    load_block,
)
# isort: on

MOTOR_TIME_STEP = 0.001
"""Seconds of one step of the motor-level model, as long as a tick of the firmware."""
MOTOR_SWITCHES = (MOTOR_ALIVE_1, MOTOR_ALIVE_2, MOTOR_ALIVE_3, MOTOR_ALIVE_4)
"""Places in a block that say whether each motor may turn."""

keys: Any = numba.types.Array(numba.uint64, 2, "C", readonly=True)
whole: Any = numba.int64


@kernel(
    table,
    blocks,
    matrix,
    matrix,
    matrix,
    vector,
    memory,
    memory,
    memory,
    memory,
    keys,
    whole,
    whole,
    vector,
)
def _advance(
    x: Mat,
    lanes: Blocks,
    commands: Mat,
    force: Mat,
    torque: Mat,
    below: Vec,
    limited: Vec,
    resting: Vec,
    impact: Vec,
    lift: Vec,
    seeds: Keys,
    time: int,
    steps: int,
    options: Vec,
) -> None:
    """Advance all drones by `steps` steps of H s from step number `time`, block by block.

    x: (N, 13): states, replaced
    options: (7,): normal of the floor, deviations of the inertial sensors
    """
    normal = (options[0], options[1], options[2])
    at_rest = (options[3], options[4])
    in_flight = (options[5], options[6])
    for b in range(lanes.shape[0]):
        m = lanes[b].m
        load_block(m, b * LANE_COUNT, x, commands, force, torque, below, limited)
        for step in range(steps):
            measure_block(m, seeds[b], time + step, at_rest, in_flight)
            set_goal_thrusts(m)
            integrate_bodies(m, MOTOR_TIME_STEP)
            apply_floor(m, normal, MOTOR_TIME_STEP)
        drain_batteries(m, steps * MOTOR_TIME_STEP)
        store_block(m, b * LANE_COUNT, x, resting, impact, lift)


@kernel(table, keys, whole, vector)
def _advance_wind(blocks: Mat, seeds: Keys, time: int, wind: Vec) -> None:
    """Compute the wind at all drones for the next step.

    At time 0 the wind is drawn from its stationary distribution.
    wind: (5,): mean, gust, decay
    """
    for b in range(blocks.shape[0]):
        advance_block_wind(
            blocks[b],
            seeds[b],
            time,
            (wind[0], wind[1], wind[2]),
            wind[3],
            wind[4] if time > 0 else 0.0,
        )


@dataclass(frozen=True, slots=True)
class MotorConditions:
    """Conditions in which the drones of a motor-level world fly."""

    wind: Wind | None = None
    """The wind, None for still air."""
    imu: Imu = field(default_factory=Imu)
    """The inertial sensors."""
    disturbances: Disturbances | None = None
    """Slow random torques and forces, None for none."""
    has_ground_effect: bool = True
    """Whether the ground effect is simulated."""
    has_downwash: bool = True
    """Whether the downwash is simulated."""
    charge: float = 1.0
    """Charge of the batteries at the start, 1 is full."""
    floor_normal: Triple = (0.0, 0.0, 1.0)
    """Normal of the surface below each drone, world; the floor itself is z = 0."""


STANDARD_CONDITIONS = MotorConditions()


class MotorWorld(Truth):
    """Crazyflies with rotors that lag, batteries that sag and sensors that err, in moving air.

    A drone stands without slipping until its rotors carry it. Until its first command arrives, a
    drone on the floor has its motors stopped and a drone in the air has the motor commands of
    hover. All random draws of a drone are functions of (seed, time, id) alone, so its flight
    depends on the other drones by downwash only.

    ids: the drones, in the order of the rows
    p0: (N, 3) m: start positions
    yaw0: (N,) rad: start headings
    platform: one for all drones, or one a drone
    dt: s: one step, a multiple of 1 ms
    seed: of every random draw
    conditions: the air, the floor, the sensors and the batteries
    commands: (N, 4): shares of the firmware's greatest thrust, for motors 1 to 4
    force: (N, 3) N, world: external forces, held until they are changed
    torque: (N, 3) N m, body: external torques, held until they are changed
    """

    def __init__(
        self,
        ids: Sequence[int],
        p0: Mat,
        yaw0: Vec | None = None,
        platform: Platform | Sequence[Platform] = CRAZYFLIE_21,
        dt: float = 0.01,
        *,
        seed: int = 0,
        conditions: MotorConditions = STANDARD_CONDITIONS,
    ) -> None:
        super().__init__(ids, p0, yaw0, platform, dt)
        self._steps = round(dt / MOTOR_TIME_STEP)
        if self._steps < 1 or abs(self._steps * MOTOR_TIME_STEP - dt) > 1e-9:
            raise ConfigError("MotorWorld: dt", dt, "a multiple of 0.001 s")
        n = len(self.ids)
        self._normal = _normalise_upward(conditions.floor_normal)
        self.states[self._resting > 0.0, 6:10] = _tilt_attitudes(
            self.states[self._resting > 0.0, 6:10], self._normal
        )
        hover = [row.weight / (4.0 * row.firmware.thrust_max) for row in self.platforms]
        self.commands = np.where(self._resting > 0.0, 0.0, hover)[:, None] * np.ones(4)
        self.force = np.zeros((n, 3))
        self.torque = np.zeros((n, 3))
        self._wrenches = ExternalWrenches(self.force, self.torque)
        if conditions.disturbances is not None:
            self._wrenches = DisturbedWrenches(
                self._wrenches,
                self.ids,
                self.platforms,
                conditions.disturbances,
                seed,
                dt,
            )
        self._below = np.zeros(n)
        self._lift = np.zeros(n)
        self._radius = np.array([row.radius for row in self.platforms])
        self._heads = np.zeros(_count_buckets(n), np.int64)
        self._chain = np.zeros((n, 3), np.int64)
        self._downwash = conditions.has_downwash and n > 1
        self._conditions = conditions
        sensors = conditions.imu
        self._options = np.array([*self._normal, *sensors.deviations(MOTOR_TIME_STEP)])
        self._sensors, self._gusts = (
            self._keys(seed, RANDOM_STREAMS.sensor_noise),
            self._keys(seed, RANDOM_STREAMS.gusts),
        )
        self._blocks = np.zeros((-(-n // LANE_COUNT), BLOCK_SIZE))
        self._lanes = self._blocks.view(block_fields)[:, 0]
        self._fill(seed, conditions)
        self._run(0, 0)
        self._began = self._blocks.copy()

    def _keys(self, seed: int, use: int) -> Keys:
        """Return (blocks, LANE_COUNT) keys of the drones' streams; empty lanes repeat the last drone's."""
        return arrange_in_lanes(
            np.array([derive_stream_key(seed, use, i) for i in self.ids], np.uint64)
        )

    def _fill(self, seed: int, conditions: MotorConditions) -> None:
        """Fill the blocks with constants and initial values.

        The empty lanes of the last block repeat its last drone, with the motors cut.
        """
        rows = [
            compute_constants(platform, MOTOR_TIME_STEP, conditions.has_ground_effect)
            for platform in self.platforms
        ]
        for name in rows[0]:
            self._put(name, np.array([row[name] for row in rows]))
        for c in range(13):
            self._put(c * LANE_COUNT, self.states[:, c])
        thrusts = (
            self.commands
            * np.array([row.firmware.thrust_max for row in self.platforms])[:, None]
        )
        slopes = np.array(
            [
                _compute_thrust_slopes(row, f)
                for row, f in zip(self.platforms, thrusts, strict=True)
            ]
        )
        for c in range(4):
            self._put(GOAL_THRUST_1 + c * LANE_COUNT, thrusts[:, c])
            self._put(ROTOR_THRUST_1 + c * LANE_COUNT, thrusts[:, c])
            self._put(STAGE_THRUST_1 + c * LANE_COUNT, thrusts[:, c])
            self._put(THRUST_SLOPE_1 + c * LANE_COUNT, slopes[:, c])
        self._lift[:] = thrusts.sum(axis=1)
        specific = np.array(
            [STANDARD_GRAVITY * rotation(q)[2] for q in self.states[:, 6:10]]
        )
        drawn = [
            [draw_uniform(key, c) for c in range(6)]
            for key in (
                derive_stream_key(seed, RANDOM_STREAMS.sensor_bias, i) for i in self.ids
            )
        ]
        sensors = conditions.imu
        bias = np.array(drawn) * np.repeat([sensors.gyro_bias, sensors.acc_bias], 3)
        for c in range(3):
            self._put(SPECIFIC_FORCE_X + c * LANE_COUNT, specific[:, c])
        for c in range(6):
            self._put(GYROSCOPE_BIAS_X + c * LANE_COUNT, bias[:, c])
        self._put(BATTERY_CHARGE, np.full(len(self.ids), conditions.charge))
        self._put(AIRBORNE_FLAG, 1.0 - self._resting)
        for motor in MOTOR_SWITCHES:
            self._put(motor, np.ones(len(self.ids)))
        for row in range(len(self.ids), len(self._blocks) * LANE_COUNT):
            self._blocks[
                -1,
                [lane + row % LANE_COUNT for lane in (AIRBORNE_FLAG, *MOTOR_SWITCHES)],
            ] = 0.0

    def _put(self, name: int, values: Vec) -> None:
        self._blocks[:, name : name + LANE_COUNT] = arrange_in_lanes(values)

    def _of(self, i: int, name: int) -> float:
        block, lane = divmod(self.row[i], LANE_COUNT)
        return float(self._blocks[block, name + lane])

    def command(self, i: int, u: Vec | Sequence[float]) -> None:
        """Hold the commands u (4,) for motors 1 to 4 of drone i from now on.

        u: shares of the firmware's greatest thrust
        """
        self.commands[self.row[i]] = u

    def cut(self, i: int) -> None:
        """Stop the motors of drone i for good."""
        self.turn(i, (False,) * len(MOTOR_SWITCHES))

    def turn(self, i: int, motors: Sequence[bool]) -> None:
        """Set which of motors 1 to 4 of drone i obey commands; the others stand still."""
        block, lane = divmod(self.row[i], LANE_COUNT)
        self._blocks[block, [motor + lane for motor in MOTOR_SWITCHES]] = motors

    def charge_to(self, i: int, charge: float) -> None:
        """Give drone i another battery with this charge, 0 to 1."""
        block, lane = divmod(self.row[i], LANE_COUNT)
        self._blocks[block, BATTERY_CHARGE + lane] = charge

    def forget_fall(self, i: int) -> None:
        """Forget the fastest touch-down of drone i."""
        block, lane = divmod(self.row[i], LANE_COUNT)
        self._blocks[block, IMPACT_SPEED + lane] = 0.0
        self.impact[self.row[i]] = 0.0

    def restore(self, i: int) -> None:
        """Put drone i back to its start, in its initial condition; the others fly on."""
        row, (block, lane) = self.row[i], divmod(self.row[i], LANE_COUNT)
        began = self._began[block, lane::LANE_COUNT]
        self._blocks[block, lane::LANE_COUNT] = began
        self.states[row], self.commands[row] = (
            began[:13],
            [
                self._of(i, c)
                for c in (
                    MOTOR_COMMAND_1,
                    MOTOR_COMMAND_2,
                    MOTOR_COMMAND_3,
                    MOTOR_COMMAND_4,
                )
            ],
        )
        self._resting[row] = 1.0 - self._of(i, AIRBORNE_FLAG)
        self.impact[row] = 0.0
        self._lift[row] = self._of(i, TOTAL_LIFT)

    def replace_body(self, i: int, platform: Platform) -> None:
        """Give drone i another true body; its state, rotors and battery stay as they are."""
        super().replace_body(i, platform)
        row = self.row[i]
        block, lane = divmod(row, LANE_COUNT)
        constants = compute_constants(
            platform, MOTOR_TIME_STEP, self._conditions.has_ground_effect
        )
        for name, value in constants.items():
            self._blocks[block, name + lane] = value
        self._radius[row] = platform.radius

    def vbat(self, i: int) -> float:
        """Return the voltage of drone i's battery under load, in V; 0 when it is empty."""
        return self._of(i, BATTERY_VOLTAGE)

    def charge(self, i: int) -> float:
        """Return the remaining charge of drone i's battery; 1 is full."""
        return self._of(i, BATTERY_CHARGE)

    def gyro(self, i: int) -> Vec:
        """Return the last reading of drone i's gyroscope: (3,) rad/s, body."""
        return np.array(
            [self._of(i, c) for c in (GYROSCOPE_X, GYROSCOPE_Y, GYROSCOPE_Z)]
        )

    def accelerometer(self, i: int) -> Vec:
        """Return the last reading of drone i's accelerometer: (3,) m/s2, body, the specific force."""
        return np.array(
            [
                self._of(i, c)
                for c in (ACCELEROMETER_X, ACCELEROMETER_Y, ACCELEROMETER_Z)
            ]
        )

    def wind(self, i: int) -> Vec:
        """Return the wind at drone i: (3,) m/s, world."""
        return np.array([self._of(i, c) for c in (WIND_X, WIND_Y, WIND_Z)])

    def below(self, i: int) -> float:
        """Return the downward force in N on drone i from the downwash of other drones."""
        return float(self._below[self.row[i]])

    def step(self) -> None:
        """Advance every drone by dt; the air is computed once, at the beginning of the step."""
        air = self._conditions.wind
        if air is not None:
            wind = np.array([*air.mean, air.gust, math.exp(-self.dt / air.time)])
            _advance_wind(self._blocks, self._gusts, self.tick, wind)
        if self._downwash:
            compute_downwash(
                self.states,
                self._lift,
                self._radius,
                self._heads,
                self._chain,
                self._below,
            )
        self._wrenches.advance(self.tick, self._resting)
        self._run(self.tick * self._steps, self._steps)
        self.tick += 1

    def _run(self, time: int, steps: int) -> None:
        _advance(
            self.states,
            self._lanes,
            self.commands,
            self._wrenches.force,
            self._wrenches.torque,
            self._below,
            self.limited,
            self._resting,
            self.impact,
            self._lift,
            self._sensors,
            time,
            steps,
            self._options,
        )


def _compute_thrust_slopes(platform: Platform, f: Vec) -> Vec:
    """Return the change of the rotors' thrusts f (4,) with their speed: (4,) N/rpm."""
    c1, c2 = platform.rotor.thrust
    return np.sqrt(c1 * c1 + 4.0 * c2 * f)


def _count_buckets(n: int) -> int:
    """Return a power of two, two to four times n."""
    return 1 << max(2 * n - 1, 1).bit_length()


def _normalise_upward(normal: Triple) -> Triple:
    """Return the unit vector along the normal of a floor.

    Raises ConfigError if the normal does not point upwards.
    """
    length = math.sqrt(sum(c * c for c in normal))
    if not math.isfinite(length) or not normal[2] > 0.5 * length:
        raise ConfigError(
            "MotorWorld: floor_normal",
            normal,
            "a vector within 60 degrees of (0, 0, 1)",
        )
    return (normal[0] / length, normal[1] / length, normal[2] / length)


def _tilt_attitudes(q: Mat, normal: Triple) -> Mat:
    """Turn level attitudes (N, 4) the shortest way until their z axis is the normal."""
    s = math.hypot(normal[0], normal[1])
    a = math.atan2(s, normal[2]) / s if s > 0.0 else 0.0
    turned = rotation_exponential(-a * normal[1], a * normal[0], 0.0)
    return np.array([quaternion_product(turned, row) for row in q]).reshape(-1, 4)
