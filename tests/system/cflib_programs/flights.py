"""Fly: by the high-level commander, by cflib's commanders of positions and motions, by trajectories and set-points."""

import math
import time

from cflib.crazyflie import Crazyflie
from cflib.crazyflie.high_level_commander import HighLevelCommander
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.mem import (
    CompressedSegment,
    CompressedStart,
    MemoryElement,
    Poly4D,
)
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie
from cflib.positioning.motion_commander import MotionCommander
from cflib.positioning.position_hl_commander import PositionHlCommander


class Watched:
    """Where it thinks it is, m, and its heading, deg."""

    def __init__(self, scf):
        self.data, config = {}, LogConfig(name="where", period_in_ms=20)
        for axis in ("x", "y", "z", "yaw"):
            config.add_variable(f"stateEstimate.{axis}", "float")
        config.add_variable("supervisor.info", "uint16_t")
        scf.cf.log.add_config(config)
        config.data_received_cb.add_callback(
            lambda stamp, data, _: self.data.update(data)
        )
        config.start()
        time.sleep(0.2)
        self.home = self.p

    @property
    def p(self):
        return [self.data[f"stateEstimate.{axis}"] for axis in "xyz"]

    @property
    def yaw(self):
        return self.data["stateEstimate.yaw"]

    @property
    def moved(self):
        """m, since the start."""
        return [b - a for a, b in zip(self.home, self.p, strict=True)]

    def is_at(self, x, y, z, by=0.12):
        assert math.dist(self.moved, (x, y, z)) < by, (self.moved, (x, y, z))


def high_level(uri, cache):
    """Take-off, go_to, relative go_to with a turn, spiral, land."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        scf.cf.supervisor.send_arming_request(True)
        where, commander = Watched(scf), scf.cf.high_level_commander
        x, y, _ = where.home
        commander.takeoff(0.5, 1.5)
        time.sleep(2.0)
        where.is_at(0.0, 0.0, 0.5)
        assert scf.cf.supervisor.is_flying
        commander.go_to(x + 0.3, y, 0.5, 0.0, 1.5)
        time.sleep(2.0)
        where.is_at(0.3, 0.0, 0.5)
        commander.go_to(0.0, 0.3, 0.1, math.pi / 2, 1.5, relative=True)
        time.sleep(2.0)
        where.is_at(0.3, 0.3, 0.6)
        assert abs(where.yaw - 90.0) < 5.0, where.yaw
        assert scf.cf.supervisor.hl_traj_finished
        commander.spiral(math.pi / 2, 0.3, 0.3, 0.0, 2.0)
        time.sleep(2.5)
        where.is_at(0.0, 0.6, 0.6, by=0.12)
        commander.land(0.0, 1.5, yaw=None)
        time.sleep(2.2)
        commander.stop()
        assert abs(where.moved[2]) < 0.05, where.moved


def motion_commander(uri, cache):
    """The drone flies forward, turns and flies left by its body's axes; then its planner takes it up to heading 0."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        where = Watched(scf)
        with MotionCommander(scf, default_height=0.4) as motion:
            time.sleep(0.5)
            motion.forward(0.3, velocity=0.4)
            motion.turn_left(90)
            time.sleep(0.3)
            motion.left(0.2, velocity=0.4)
            time.sleep(0.5)
            where.is_at(0.1, 0.0, 0.4, by=0.18)
            assert abs(where.yaw - 90.0) < 8.0, where.yaw
        time.sleep(1.0)
        assert abs(where.moved[2]) < 0.05, where.moved
        with PositionHlCommander(scf, default_height=0.4):
            time.sleep(3.0)
            assert abs(where.moved[2] - 0.4) < 0.18, where.moved
            assert abs(where.yaw) < 12.0, where.yaw
        time.sleep(0.5)
        assert abs(where.moved[2]) < 0.05, where.moved


def position_commander(uri, cache):
    """The drone flies to places."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        where = Watched(scf)
        x, y, _ = where.home
        with PositionHlCommander(
            scf, x=x, y=y, z=0.0, default_height=0.4, default_velocity=0.4
        ) as commander:
            commander.go_to(x + 0.2, y + 0.2)
            commander.up(0.2)
            time.sleep(0.5)
            where.is_at(0.2, 0.2, 0.6)
        time.sleep(0.5)
        assert abs(where.moved[2]) < 0.05, where.moved


def trajectory(uri, cache):
    """One piece of polynomials, relative to where it is, at half the pace."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        where, commander = Watched(scf), scf.cf.high_level_commander
        (memory,) = scf.cf.mem.get_mems(MemoryElement.TYPE_TRAJ)
        rest = [0.0] * 8  # x(t) = 0.4 (35 t4 - 84 t5 + 70 t6 - 20 t7)
        ahead = [0.0, 0.0, 0.0, 0.0, 14.0, -33.6, 28.0, -8.0]
        memory.trajectory = [
            Poly4D(
                1.0,
                x=Poly4D.Poly(ahead),
                y=Poly4D.Poly(rest),
                z=Poly4D.Poly(rest),
                yaw=Poly4D.Poly(rest),
            )
        ]
        assert memory.write_data_sync()
        commander.define_trajectory(1, 0, 1)
        commander.takeoff(0.4, 1.2)
        time.sleep(1.6)
        commander.start_trajectory(1, 1.5, relative_position=True)
        time.sleep(2.0)
        where.is_at(0.4, 0.0, 0.4)
        commander.start_trajectory(1, 1.5, relative_position=False, reversed=True)
        time.sleep(0.1)
        commander.land(0.0, 1.2)
        time.sleep(1.6)


def compressed_trajectory(uri, cache):
    """Bezier curves of 16-bit points."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        where, commander = Watched(scf), scf.cf.high_level_commander
        (memory,) = scf.cf.mem.get_mems(MemoryElement.TYPE_TRAJ)
        memory.trajectory = [
            CompressedStart(0.0, 0.0, 0.0, 0.0),
            CompressedSegment(1.5, [0.0, 0.3, 0.3], [0.0, 0.0, 0.2], [], []),
            CompressedSegment(0.5, [], [], [], []),
            CompressedSegment(1.0, [0.3, 0.3, 0.3, 0.1, 0.1, 0.1, 0.1], [], [0.1], []),
        ]
        assert memory.write_data_sync()
        commander.define_trajectory(
            2,
            0,
            len(memory.trajectory),
            type=HighLevelCommander.TRAJECTORY_TYPE_POLY4D_COMPRESSED,
        )
        commander.takeoff(0.4, 1.2)
        time.sleep(1.6)
        commander.start_trajectory(2, 1.0, relative_position=True)
        time.sleep(1.9)
        where.is_at(0.3, 0.2, 0.4)
        time.sleep(1.5)
        where.is_at(0.1, 0.2, 0.5)
        commander.land(0.0, 1.2)
        time.sleep(1.6)


def set_points(uri, cache):
    """Every kind at 20 Hz, then the planner again."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        where, commander = Watched(scf), scf.cf.commander
        x, y, _ = where.home

        def hold(seconds, send, *values):
            for _ in range(round(20 * seconds)):
                send(*values)
                time.sleep(0.05)

        hold(1.5, commander.send_position_setpoint, x, y, 0.4, 0.0)
        hold(0.5, commander.send_velocity_world_setpoint, 0.0, 0.0, 0.1, 0.0)
        hold(0.5, commander.send_zdistance_setpoint, 0.0, 0.0, 0.0, 0.4)
        hold(0.5, commander.send_hover_setpoint, 0.0, 0.0, 0.0, 0.4)
        hold(
            1.0,
            commander.send_full_state_setpoint,
            [x, y, 0.4],
            [0.0] * 3,
            [0.0] * 3,
            [0, 0, 0, 1],
            0.0,
            0.0,
            0.0,
        )
        where.is_at(0.0, 0.0, 0.4, by=0.15)
        commander.send_notify_setpoint_stop()
        scf.cf.high_level_commander.land(0.0, 1.2)
        time.sleep(1.8)
        assert abs(where.moved[2]) < 0.05, where.moved


PROGRAMS = (
    high_level,
    motion_commander,
    position_commander,
    trajectory,
    compressed_trajectory,
    set_points,
)
