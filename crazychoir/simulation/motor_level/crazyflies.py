"""Whole Crazyflies: the motor-level world with firmware on board, one compiled pass a step."""

from collections.abc import Iterable, Sequence
from typing import Any, Self

import numpy as np

from crazychoir.numerics.kernels import kernel, matrix, memory, table, vector
from crazychoir.numerics.math3d import (
    Triple,
    quaternion_product,
    rotation,
    rotation_exponential,
    yaw_of,
)
from crazychoir.platforms import CRAZYFLIE_21, Platform
from crazychoir.simulation.common.draws import Keys
from crazychoir.simulation.common.mismatch import apply_model_errors
from crazychoir.simulation.common.world import WorldSetup, make_unsupported_kind_error
from crazychoir.simulation.motor_level.air import Wind
from crazychoir.simulation.motor_level.battery import drain_batteries
from crazychoir.simulation.motor_level.body import integrate_bodies, set_goal_thrusts
from crazychoir.simulation.motor_level.disturbances import Disturbances
from crazychoir.simulation.motor_level.floor import apply_floor
from crazychoir.simulation.motor_level.imperfections import (
    LARGEST_IMBALANCE,
    Imperfections,
)
from crazychoir.simulation.motor_level.imu import VIBRATING_IMU, measure_block
from crazychoir.simulation.motor_level.motor_control import (
    MOTOR_CONTROLS,
    CrazyflieLink,
    stream_motion_setpoints,
    stream_thrust_setpoints,
)
from crazychoir.simulation.motor_level.motors import (
    MOTOR_TIME_STEP,
    MotorConditions,
    MotorWorld,
    keys,
    whole,
)
from crazychoir.simulation.motor_level.pose_delay import PoseDelay
from crazychoir.simulation.onboard.estimator import see_poses
from crazychoir.simulation.onboard.logs import FIRMWARE_LOG_READERS, read_log_variable
from crazychoir.simulation.onboard.loop import stabilize
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.record import (
    CONTROLLER_KINDS,
    FLOOR_ALTITUDE,
    Fleet,
    make_mixed_fleet,
    rows,
)
from crazychoir.types import Bools, Ints, Mat, Pose, Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    ACCELEROMETER_X,
    ACCELEROMETER_Y,
    ACCELEROMETER_Z,
    GYROSCOPE_X,
    GYROSCOPE_Y,
    GYROSCOPE_Z,
    LANE_COUNT,
    MOTOR_COMMAND_1,
    MOTOR_COMMAND_2,
    MOTOR_COMMAND_3,
    MOTOR_COMMAND_4,
    BATTERY_VOLTAGE,
    Blocks,
    blocks,
    store_block,
    load_block,
)
# isort: on

FIRMWARE_POSITION_KINDS = ("vel", "xyz", "fullstate")
"""Kinds of commands for which the firmware controls position or velocity."""
POSES_PER_UPDATE = 7
"""Number of poses for each pose that is passed to the estimator in rate control.

If only rates are controlled on board, the estimator gets 14 poses a second of 100.
"""


@kernel()
def _run_firmware(m: Vec, first: int, firmware: Fleet) -> None:
    """Run the firmware of a block's drones for 1 ms: sensor readings in, motor commands out."""
    for k in range(min(LANE_COUNT, firmware.shape[0] - first)):
        fw = firmware[first + k]
        stabilize(
            fw,
            m[GYROSCOPE_X + k],
            m[GYROSCOPE_Y + k],
            m[GYROSCOPE_Z + k],
            m[ACCELEROMETER_X + k],
            m[ACCELEROMETER_Y + k],
            m[ACCELEROMETER_Z + k],
        )
        u = fw.motors
        m[MOTOR_COMMAND_1 + k] = u[0]
        m[MOTOR_COMMAND_2 + k] = u[1]
        m[MOTOR_COMMAND_3 + k] = u[2]
        m[MOTOR_COMMAND_4 + k] = u[3]


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
    rows,
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
    firmware: Fleet,
) -> None:
    """Advance all drones as `motors._advance`, with the firmware between sensors and motors."""
    normal = (options[0], options[1], options[2])
    at_rest = (options[3], options[4])
    in_flight = (options[5], options[6])
    for b in range(lanes.shape[0]):
        m = lanes[b].m
        first = b * LANE_COUNT
        load_block(m, first, x, commands, force, torque, below, limited)
        for step in range(steps):
            measure_block(m, seeds[b], time + step, at_rest, in_flight)
            _run_firmware(m, first, firmware)
            set_goal_thrusts(m)
            integrate_bodies(m, MOTOR_TIME_STEP)
            apply_floor(m, normal, MOTOR_TIME_STEP)
        drain_batteries(m, steps * MOTOR_TIME_STEP)
        store_block(m, first, x, resting, impact, lift)
        for k in range(min(LANE_COUNT, x.shape[0] - first)):
            firmware[first + k].vbat = m[BATTERY_VOLTAGE + k]
            firmware[first + k].asl = FLOOR_ALTITUDE + x[first + k, 2]


@kernel(rows)
def _count_user_laws(firmware: Fleet) -> int:
    """Return the number of drones that are controlled by a law of a user."""
    count = 0
    for i in range(firmware.shape[0]):
        if firmware[i].controller == CONTROLLER_KINDS.out_of_tree:
            count += 1
    return count


class CrazyflieWorld(MotorWorld):
    """MotorWorld with firmware on board of each drone.

    Motors stand still until the firmware turns them, also in the air.

    platform: platform for which the firmware is made
    bodies: true platform of each drone, None for the platform of the firmware
    pose_delay: way of the poses to the estimators on board, None if they arrive at once
    options: options of MotorWorld
    onboard: firmware of each drone by id, with everything that a radio reaches: set-points,
        planner,
        parameters, logs and external poses
    """

    flies: tuple[str, ...] = tuple(MOTOR_CONTROLS)
    takes_rows: tuple[str, ...] = ("fpqr", "frpy")
    command_timeout: float | None = None

    def __init__(
        self,
        ids: Sequence[int],
        p0: Mat,
        yaw0: Vec | None = None,
        platform: Platform | Sequence[Platform] = CRAZYFLIE_21,
        *,
        bodies: Sequence[Platform] | None = None,
        pose_delay: PoseDelay | None = None,
        **options: Any,
    ) -> None:
        platforms = (
            [platform] * len(ids) if isinstance(platform, Platform) else platform
        )
        self._firmware = make_mixed_fleet(platforms)
        self.onboard: dict[int, Onboard] = {}
        self._needs_arming = np.array(
            [row.firmware.needs_arming for row in platforms], np.int64
        )
        self._pose_delay = pose_delay
        self._pose_counts = np.zeros(len(ids), np.int64)
        self._pose_intervals = np.ones(len(ids), np.int64)
        super().__init__(
            ids, p0, yaw0, platforms if bodies is None else bodies, **options
        )
        for row, i in enumerate(self.ids):
            self.onboard[i] = Onboard(platforms[row], self._firmware, row)
            self.onboard[i].place(self.states[row, :3], yaw_of(self.states[row, 6:10]))
            self._firmware["vbat_low"][row] = self.vbat(i)

    @classmethod
    def of(cls, setup: WorldSetup, **more: Any) -> Self:
        """Make the world of a swarm file.

        setup: what the swarm file asks for, with its table [motors] as options
        more: further options of this class
        """
        options = setup.options
        share = options["imperfections"]
        imperfections = Imperfections(
            share * options["speed_moment"],
            share * options["rate_damping"],
            min(share * options["imbalance"], LARGEST_IMBALANCE),
        )
        true_bodies = setup.build_bodies(apply_model_errors)
        bodies = [
            imperfections.apply(row, setup.seed, i)
            for i, row in zip(setup.ids, true_bodies, strict=True)
        ]
        return cls(
            setup.ids,
            np.array(setup.homes, dtype=float),
            np.array(setup.yaws),
            setup.platforms,
            dt=setup.dt,
            seed=setup.seed,
            conditions=_find_conditions(setup),
            bodies=bodies,
            pose_delay=_find_pose_delay(setup),
            **more,
        )

    def link(self, i: int, kind: str = "fpqr") -> CrazyflieLink:
        """Return the link to drone i for commands of this kind.

        Raises ConfigError if the firmware does not know the kind.
        """
        if kind not in self.flies:
            raise make_unsupported_kind_error(i, kind, self.flies)
        self._pose_intervals[self.row[i]] = (
            1 if kind in FIRMWARE_POSITION_KINDS else POSES_PER_UPDATE
        )
        return CrazyflieLink(self.onboard[i], kind)

    def see(self, i: int, pose: Pose) -> None:
        """Pass a pose to the estimator on board of drone i.

        If only rates are controlled on board, few poses are passed, because radio time is scarce.
        """
        flat = np.zeros((len(self.ids), 7))
        seen = np.zeros(len(self.ids), bool)
        flat[self.row[i]] = pose.flat
        seen[self.row[i]] = True
        self.see_frame(flat, seen)

    def see_frame(self, flat: Mat, seen: Bools) -> None:
        """Pass the poses of one exposure to the estimators on board, as `see`.

        flat: (n, 7): rows laid out as Pose.flat, one a drone
        seen: (n,): whether the drone was seen
        """
        if self._pose_delay is None:
            self._take_poses(flat, seen)
        else:
            self._pose_delay.send(self.tick, flat, seen)

    def step(self) -> None:
        """Advance every drone by dt; poses that are due arrive at the beginning of the step."""
        if self._pose_delay is not None:
            for flat, seen in self._pose_delay.receive(self.tick):
                self._take_poses(flat, seen)
        super().step()

    def _take_poses(self, flat: Mat, seen: Bools) -> None:
        see_poses(self._firmware, flat, seen, self._pose_counts, self._pose_intervals)

    def take_commands(self, inputs: Mat, is_new: Ints) -> None:
        """Pass the new set-points of all drones to their firmware, as `link` would.

        inputs: (n, 4): rows laid out as FPQR.flat or FRPY.flat, by the kind of each drone's link
        is_new: (n,): 1 for a drone with a new set-point
        """
        stream_thrust_setpoints(self._firmware, inputs, is_new, self._needs_arming)

    def take_motions(self, inputs: Mat, is_new: Ints, are_places: bool) -> None:
        """Pass new set-points of velocity or of position of all drones to their firmware.

        inputs: (n, 4): velocity (3,) m/s, world, and yaw rate rad/s; or position (3,) m, world, and
            heading rad
        is_new: (n,): 1 for a drone with a new set-point
        are_places: whether the inputs are positions
        """
        stream_motion_setpoints(self._firmware, inputs, is_new, float(are_places))

    @property
    def failed(self) -> dict[int, str]:
        """Drones with a number that is not finite, and where it was found; they cannot recover."""
        parts = {
            "the requests to its motors": self._firmware["request"],
            "the PWM ratios of its motors": self._firmware["ratio"],
            "the commands of its motors": self._firmware["motors"],
            "the state of its body": self.states,
        }
        return {
            self.ids[
                row
            ]: f"{part}: found {numbers[row].tolist()}; allowed: finite numbers"
            for part, numbers in parts.items()
            for row in np.flatnonzero(~np.isfinite(numbers).all(axis=1)).tolist()
        }

    def restore(self, i: int) -> None:
        """Put the body of drone i back as MotorWorld does; the firmware is restarted elsewhere."""
        super().restore(i)
        row = self.row[i]
        self._firmware["vbat"][row] = self._firmware["vbat_low"][row] = self.vbat(i)

    def replace_drone(self, i: int, other: "CrazyflieWorld", j: int) -> None:
        """Put drone i into the condition of drone j of another world.

        Body, rotors, battery, sensors and firmware are those of drone j.
        """
        row = self.row[i]
        source = other.row[j]
        super().replace_body(i, other.platforms[source])
        block, lane = divmod(row, LANE_COUNT)
        block_there, lane_there = divmod(source, LANE_COUNT)
        lanes_there = other._blocks[block_there, lane_there::LANE_COUNT]
        self._blocks[block, lane::LANE_COUNT] = lanes_there
        for name in ("states", "commands", "limited", "impact", "_resting", "_lift"):
            getattr(self, name)[row] = getattr(other, name)[source]
        self._firmware[row] = other._firmware[source]
        self._needs_arming[row] = other._needs_arming[source]
        self._pose_intervals[row] = other._pose_intervals[source]
        self._pose_counts[row] = other._pose_counts[source]

    def put(self, i: int, p: Vec, yaw: float) -> None:
        """Put drone i at rest at p (3,) m, world; its motors and its firmware run on.

        The estimate on board begins there.
        yaw: rad: heading
        """
        super().put(i, p, yaw)
        self.onboard[i].place(p, yaw)

    @property
    def variables(self) -> Iterable[str]:
        """Names of the log variables of the drones."""
        return FIRMWARE_LOG_READERS

    def log(self, i: int, name: str) -> float:
        """Return a log variable of drone i now, in the firmware's unit."""
        return read_log_variable(self._firmware, self.row[i], name)

    def command(self, i: int, u: Vec | Sequence[float]) -> None:
        """Give drone i a set-point u (4,) = thrust N, body rates rad/s.

        Its firmware must be in rate mode.
        """
        self.onboard[i].setpoints.fpqr(*u)

    def _run(self, time: int, steps: int) -> None:
        if _count_user_laws(self._firmware) == 0:
            self._advance(time, steps)
            return
        for k in range(steps):
            self._advance(time + k, 1)
            for i in np.flatnonzero(self._firmware["law_due"]).tolist():
                self.onboard[self.ids[i]].obey_law()

    def _advance(self, time: int, steps: int) -> None:
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
            self._firmware,
        )


def _find_conditions(setup: WorldSetup) -> MotorConditions:
    """Return the conditions that the table [motors] of a swarm file asks for."""
    options = setup.options
    gusts = options["gusts"]
    wind = None
    if gusts > 0.0 or any(setup.wind):
        wind = Wind(setup.wind, gusts, options["gust_time"])
    share = options["imperfections"]
    torque = share * options["torque_disturbance"]
    force = share * options["force_disturbance"]
    disturbances = None
    if torque > 0.0 or force > 0.0:
        disturbances = Disturbances(torque, force, options["disturbance_time"])
    return MotorConditions(
        wind=wind,
        imu=VIBRATING_IMU.scaled(options["imu_noise"], share * options["vibration"]),
        disturbances=disturbances,
        has_ground_effect=options["ground_effect"],
        has_downwash=options["downwash"],
        charge=options["battery"],
        floor_normal=_find_normal(*options["floor_tilt"]),
    )


def _find_normal(roll: float, pitch: float) -> Triple:
    """Return the normal of a floor that is tilted by these angles in rad, about the world's axes."""
    tilt = quaternion_product(
        rotation_exponential(0.0, pitch, 0.0), rotation_exponential(roll, 0.0, 0.0)
    )
    x, y, z = rotation(np.array(tilt))[:, 2].tolist()
    return (x, y, z)


def _find_pose_delay(setup: WorldSetup) -> PoseDelay | None:
    """Return the way of poses that the table [motors] of a swarm file asks for."""
    share = setup.options["imperfections"]
    latency = share * setup.options["pose_latency"]
    jitter = share * setup.options["pose_jitter"]
    if latency == 0.0 and jitter == 0.0:
        return None
    return PoseDelay(latency, jitter, setup.seed, setup.dt)
