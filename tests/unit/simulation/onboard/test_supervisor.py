"""The supervisor's time-line on a bench: sensors held, commands at given ms."""

import numpy as np
import pytest

from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS
from crazychoir.simulation.onboard import loop
from crazychoir.simulation.onboard.onboard import Onboard


class Bench:
    """A drone that is held: z is its specific force along body z in g."""

    def __init__(self, platform=CRAZYFLIE_21, ready=True):
        self.onboard = Onboard(platform)
        if ready:
            self.run(200)
            assert self.onboard.state == "ready to fly"

    @property
    def now(self):
        return int(self.onboard.record["tick"])

    @property
    def turning(self):
        return bool(np.any(self.onboard.record["motors"] > 0))

    def run(self, ms, z=1.0, x=0.0):
        loop.run(
            self.onboard.rows,
            float(ms),
            0.0,
            0.0,
            0.0,
            x * STANDARD_GRAVITY,
            0.0,
            z * STANDARD_GRAVITY,
        )

    def push(self, thrust=0.3):
        self.onboard.setpoints.manual(thrust, 0.0, 0.0, 0.0)

    def until(self, state, limit=40000, send=None, every=100, **force):
        """ms until the state is entered."""
        start = self.now
        while self.onboard.state != state:
            assert self.now - start < limit, self.onboard.state
            if send and (self.now - start) % every == 0:
                send()
            self.run(1, **force)
        return self.now - start

    def fly(self):
        self.push()
        self.run(80)
        assert self.onboard.state == "flying"
        return self


def test_it_arms_itself_after_power_on():
    bench = Bench(ready=False)
    assert not bench.onboard.info & 0b1010
    assert bench.until("ready to fly") == 121
    assert bench.onboard.info & 0b1111 == 0b1110  # the firmware: 0x20E


def test_set_points_age_level_out_free_fall_locked():
    bench = Bench()
    bench.run(5)
    bench.push()
    sent = bench.now
    bench.until("flying")
    bench.until("warning: level out")
    assert 500 < bench.now - sent <= 541
    assert bench.turning
    bench.until("exception: free fall")
    assert 2000 < bench.now - sent <= 2041
    bench.run(1)
    assert not bench.turning
    assert bench.until("locked") <= 40
    bench.onboard.emergency_stop_watchdog()
    assert bench.onboard.recover()  # it has not crashed
    bench.push()
    bench.run(5000)
    assert bench.onboard.state == "locked"
    assert bench.onboard.info >> 6 & 1
    assert not bench.turning


def test_a_drone_flies_in_two_states_alone_not_while_its_motors_may_still_turn():
    """The firmware: after an emergency stop is_flying falls within 40 ms."""
    bench = Bench().fly()
    assert bench.onboard.info >> 4 & 1
    assert bench.onboard.log("sys.isFlying") == 1.0
    bench.onboard.emergency_stop()
    bench.run(40)
    assert bench.onboard.state == "exception: free fall"
    assert not bench.onboard.info >> 4 & 1
    assert bench.onboard.log("sys.isFlying") == 0.0


def test_the_bits_are_those_of_the_last_pass_at_25_hz():
    bench = Bench().fly()
    while bench.now % 40 != 1:
        bench.run(1)
    before = bench.onboard.info
    bench.onboard.arm(False)
    bench.run(39)
    assert bench.onboard.info == before
    bench.run(1)
    assert not bench.onboard.info & 0b10


def test_a_drone_cannot_be_armed_before_the_supervisor_has_seen_it_disarmed():
    """The firmware refuses for up to 40 ms: 81 00 00."""
    bench = Bench(CRAZYFLIE_21_BRUSHLESS, ready=False)
    bench.run(200)
    assert bench.onboard.arm()
    bench.until("ready to fly")
    bench.onboard.arm(False)
    assert not bench.onboard.arm()
    bench.until("pre-flight checks passed")
    assert bench.onboard.info & 0b1
    assert bench.onboard.arm()


def test_exactly_500_ms_old_is_not_too_old():
    bench = Bench()
    bench.fly()
    while (bench.now + 500) % 40:
        bench.run(1)
    bench.push()
    bench.run(501)
    assert bench.onboard.state == "flying"
    bench.run(40)
    assert bench.onboard.state == "warning: level out"


def test_level_out_keeps_the_thrust_and_a_new_set_point_recovers():
    bench = Bench().fly()
    bench.onboard.setpoints.manual(0.3, 0.5, 0.0, 1.0)
    bench.run(100)
    fw = bench.onboard.record
    assert fw["target_roll"] == pytest.approx(28.65, abs=0.01)
    thrust = float(fw["thrust"])
    bench.until("warning: level out")
    bench.run(2)
    assert (fw["target_roll"], fw["target_pitch"], fw["thrust"]) == (0.0, 0.0, thrust)
    assert fw["level"]["yaw_rate"] == 0.0
    bench.push()
    assert bench.until("flying") <= 40


def test_a_landed_drone_waits_3_s_and_begins_anew():
    bench = Bench().fly()
    assert bench.until(
        "landed", send=bench.onboard.setpoints.stop_setpoint
    ) == pytest.approx(2000, abs=80)
    landed = bench.now
    assert bench.until(
        "reset", send=bench.onboard.setpoints.stop_setpoint
    ) == pytest.approx(3000, abs=40)
    assert bench.now - landed >= 3000 - 1
    assert bench.until("ready to fly") <= 200


def test_a_landed_drone_may_fly_again():
    bench = Bench().fly()
    bench.until("landed", send=bench.onboard.setpoints.stop_setpoint)
    bench.push()
    assert bench.until("flying") <= 42


@pytest.mark.parametrize("platform", [CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS])
def test_ready_lasts_30_s(platform):
    bench = Bench(platform, ready=False)
    bench.run(200)
    if platform.firmware.needs_arming:
        assert bench.onboard.state == "pre-flight checks passed"
        assert bench.onboard.arm()
    bench.until("ready to fly")
    assert bench.until("pre-flight checks not passed") == pytest.approx(30000, abs=41)
    bench.run(200)
    assert bench.onboard.state == (
        "pre-flight checks passed" if platform.firmware.needs_arming else "ready to fly"
    )


def test_a_brushless_drone_needs_arming_and_its_motors_wait():
    bench = Bench(CRAZYFLIE_21_BRUSHLESS, ready=False)
    assert not bench.onboard.arm()  # the checks are not passed yet
    bench.run(200)
    bench.push()
    bench.run(50)
    assert not bench.turning
    assert bench.onboard.arm()
    bench.push()
    bench.run(100)
    assert bench.turning


def test_disarming_in_flight_cuts_and_resets():
    bench = Bench().fly()
    assert bench.onboard.arm(False)
    assert bench.until("reset") <= 42
    bench.run(2)
    assert not bench.turning


@pytest.mark.parametrize(("z", "after"), [(0.3, 1000), (-0.5, 100)])
def test_tumbling_crashes_a_flying_drone_and_recovery_needs_it_upright(z, after):
    bench = Bench().fly()
    ms = bench.until("crashed", send=bench.push, z=z)
    assert (
        after < ms < after + 100
    )  # the accelerometer's low-pass, the supervisor's 40 ms
    bench.run(2, z=z)
    assert not bench.turning
    assert not bench.onboard.recover()
    assert bench.onboard.info >> 7 & 1
    bench.run(200)
    assert bench.onboard.recover()
    bench.until("ready to fly")


def test_a_crash_is_told_until_it_is_forgotten_upright():
    """The firmware: bit 7 is the crash, not the state; recovery answers `82 01 01` without one."""
    bench = Bench()
    assert bench.onboard.recover()
    bench.fly().until("crashed", send=bench.push, z=-0.5)
    bench.run(200)
    assert bench.onboard.state == "crashed"
    assert bench.onboard.info >> 7 & 1
    assert bench.onboard.recover()
    assert bench.until("pre-flight checks not passed") <= 41
    assert not bench.onboard.info >> 7 & 1


def test_a_crashed_drone_can_be_locked():
    bench = Bench().fly()
    bench.until("crashed", send=bench.push, z=-0.5)
    bench.onboard.emergency_stop()
    assert bench.until("locked", z=-0.5) <= 41
    assert bench.onboard.info >> 6 & 0b11 == 0b11
    assert not bench.onboard.recover()


def test_tumbling_while_it_levels_out_locks():
    """The firmware: from level-out to free fall; from flight to crashed."""
    bench = Bench().fly()
    bench.until("warning: level out")
    bench.until("exception: free fall", z=-0.5)
    assert bench.until("locked", z=-0.5) <= 41


def test_a_drone_that_levels_out_at_idle_does_not_land():
    """The firmware: from level-out to flight or to free fall alone."""
    bench = Bench().fly()
    bench.onboard.setpoints.stop_setpoint()
    bench.until("warning: level out")
    bench.until("exception: free fall")


def test_an_emergency_stop_of_a_landed_drone_locks_it_when_it_is_disarmed():
    bench = Bench().fly()
    bench.until("landed", send=bench.onboard.setpoints.stop_setpoint)
    bench.onboard.emergency_stop()
    bench.run(200)
    assert bench.onboard.state == "landed"
    bench.until("locked", send=bench.onboard.setpoints.stop_setpoint)


def test_the_time_on_the_side_counts_for_the_time_on_the_back():
    """The firmware has one clock for both: 0.1 s of tilt, then on its back at once."""
    bench = Bench().fly()
    for _ in range(5):
        bench.push()
        bench.run(100, z=0.3)
    assert bench.onboard.state == "flying"
    assert bench.until("crashed", send=bench.push, z=-1.0) < 100


def test_free_fall_is_no_tumbling_and_the_check_can_be_switched_off():
    bench = Bench().fly()
    for _ in range(30):
        bench.push()
        bench.run(100, z=0.0)
    assert bench.onboard.state == "flying"
    bench.onboard.set("supervisor.tmblChckEn", 0)
    for _ in range(30):
        bench.push()
        bench.run(100, z=-1.0)
    assert bench.onboard.state == "flying"


def test_an_emergency_stop_cuts_within_40_ms_for_good():
    """The firmware looks for it at 25 Hz, and then at each command for the planner."""
    bench = Bench().fly()
    while bench.now % 40 != 1:
        bench.run(1)
    bench.onboard.emergency_stop()
    bench.run(39)
    assert bench.turning
    assert bench.onboard.planner.go_to((0, 0, 1), 0.0, 2.0) == 0
    bench.run(2)
    assert not bench.turning
    assert bench.onboard.planner.go_to((0, 0, 1), 0.0, 2.0) == 16
    assert bench.until("locked") <= 40
    assert bench.onboard.get("stabilizer.stop") == 0


def test_the_parameter_does_not_take_an_emergency_stop_back():
    """The firmware: the packet and the parameter are two conditions."""
    bench = Bench().fly()
    bench.until("landed", send=bench.onboard.setpoints.stop_setpoint)
    bench.onboard.emergency_stop()
    bench.onboard.set("stabilizer.stop", 0)
    bench.until("locked", send=bench.onboard.setpoints.stop_setpoint)


def test_stabilizer_stop_is_the_emergency_stop():
    bench = Bench().fly()
    bench.onboard.set("stabilizer.stop", 1)
    assert bench.until("exception: free fall") <= 42
    assert bench.until("locked") <= 42


def test_the_watchdog_of_the_emergency_stop():
    bench = Bench().fly()
    for _ in range(5):
        bench.onboard.emergency_stop_watchdog()
        bench.push()
        bench.run(300)
    bench.onboard.emergency_stop_watchdog()
    fed = bench.now
    bench.until("exception: free fall", send=bench.push)
    assert 1000 <= bench.now - fed <= 1041


def test_silence_does_nothing_while_the_planner_has_control():
    bench = Bench()
    assert bench.onboard.planner.take_off(1.0, 2.0) == 0
    bench.run(20000)
    assert bench.onboard.state == "flying"
    assert bench.onboard.info >> 8 & 0b111 == 0b011  # in control, its plan has ended


def test_planner_commands_are_refused_where_it_may_not_fly():
    bench = Bench(ready=False)
    assert bench.onboard.planner.take_off(1.0, 2.0) == 16
    bench.run(200)
    bench.onboard.emergency_stop()
    bench.run(50)
    assert bench.onboard.planner.go_to((0, 0, 1), 0.0, 2.0) == 16


def test_a_drone_that_may_no_longer_fly_has_no_plan_left():
    onboard = Onboard(CRAZYFLIE_21)
    loop.run(onboard.rows, 200.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.81)
    assert onboard.planner.take_off(0.5, 1.0) == 0
    onboard.emergency_stop()
    loop.run(onboard.rows, 200.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.81)
    assert onboard.state == "locked"
    assert onboard.record["planner"]["state"] == 0


@pytest.mark.parametrize(
    ("limit", "force", "state"),
    [(0.0, 4.0, "flying"), (2.0, 2.5, "flying"), (2.0, 4.0, "crashed")],
)
def test_a_hit_above_its_limit_crashes_a_flying_drone(limit, force, state):
    bench = Bench()
    bench.onboard.set("supervisor.crashDetectGs", limit)
    bench.fly()
    for _ in range(5):
        bench.push()
        bench.run(40, z=force)
    assert bench.onboard.state == state
