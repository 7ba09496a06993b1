"""One ms on board of one drone: sensors, estimator, commander, supervisor, controller, motors."""

import math
from typing import NamedTuple

from crazychoir.firmware.supervision import SUPERVISOR_STATES
from crazychoir.firmware.timeouts import FIRMWARE_TIMEOUTS
from crazychoir.numerics.kernels import kernel, real
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.simulation.onboard import (
    complementary,
    estimator,
    health,
    mixing,
    planner,
    supervisor,
    voronoi,
)
from crazychoir.simulation.onboard.commander import write_level_setpoint
from crazychoir.simulation.onboard.controllers import (
    brescianini,
    cascade,
    indi,
    lee,
    mellinger,
)
from crazychoir.simulation.onboard.record import (
    CONTROLLER_KINDS,
    ESTIMATOR_KINDS,
    Fleet,
    Record,
    rows,
    whole,
)


class TaskPeriods(NamedTuple):
    """Periods in ms of the tasks of the firmware."""

    attitude: int = 2
    """Period in ms of attitude and rate control, 500 Hz."""
    position: int = 10
    """Period in ms of estimator, position control and planner, 100 Hz."""
    supervisor: int = FIRMWARE_TIMEOUTS.supervision
    """Period in ms of the supervisor, 25 Hz."""


TASK_PERIODS = TaskPeriods()


def _design_butterworth(hertz: float) -> tuple[float, float, float]:
    """Return b0, a1, a2 of a low-pass of order 2 at 1 kHz (b1 = 2 b0, b2 = b0)."""
    c = math.tan(math.pi * hertz / 1000.0)
    n = 1.0 / (1.0 + math.sqrt(2.0) * c + c * c)
    return c * c * n, 2.0 * (c * c - 1.0) * n, (1.0 - math.sqrt(2.0) * c + c * c) * n


GYRO_B, GYRO_A1, GYRO_A2 = _design_butterworth(80.0)
ACC_B, ACC_A1, ACC_A2 = _design_butterworth(30.0)


class SensorSettings(NamedTuple):
    """How the firmware calibrates and converts the readings of the inertial sensors."""

    calibration_start: int = 100
    """ms after power-on before the firmware weighs itself."""
    calibration_samples: int = 200
    """Samples of the accelerometer with which the firmware weighs itself."""
    degrees_per_radian: float = 180.0 / math.pi
    """deg a rad."""
    g_per_acceleration: float = 1.0 / STANDARD_GRAVITY
    """g a m/s2."""


SENSOR_SETTINGS = SensorSettings()


@kernel()
def _filter_gyroscope(fw: Record, k: int, raw: float) -> float:
    """Filter the gyroscope's axis k with a low-pass of 80 Hz; return deg/s."""
    d = fw.delays
    value = raw * SENSOR_SETTINGS.degrees_per_radian
    y: float = GYRO_B * value + d[2 * k]
    d[2 * k] = 2.0 * GYRO_B * value - GYRO_A1 * y + d[2 * k + 1]
    d[2 * k + 1] = GYRO_B * value - GYRO_A2 * y
    return y


@kernel()
def _filter_accelerometer(fw: Record, k: int, raw: float) -> float:
    """Filter the accelerometer's axis k with a low-pass of 30 Hz; return g."""
    d = fw.delays
    value = raw * SENSOR_SETTINGS.g_per_acceleration
    i = 6 + 2 * k
    y: float = ACC_B * value + d[i]
    d[i] = 2.0 * ACC_B * value - ACC_A1 * y + d[i + 1]
    d[i + 1] = ACC_B * value - ACC_A2 * y
    return y


@kernel()
def _weigh(fw: Record, ax: float, ay: float, az: float) -> None:
    """Calibrate the accelerometer: scale the mean of SENSOR_SETTINGS.calibration_samples samples to 1 g.

    The samples are taken some time after power-on, while the drone stands with its motors off.
    """
    m = fw.ratio
    if (
        fw.tick < SENSOR_SETTINGS.calibration_start
        or max(max(m[0], m[1]), max(m[2], m[3])) > fw.idle
    ):
        return
    weight = math.sqrt(ax * ax + ay * ay + az * az)
    if abs(weight - STANDARD_GRAVITY) < 0.1 * STANDARD_GRAVITY:
        fw.acc_sum += weight
        fw.acc_count += 1.0
        if fw.acc_count >= SENSOR_SETTINGS.calibration_samples:
            fw.acc_scale = STANDARD_GRAVITY * fw.acc_count / fw.acc_sum


@kernel(rows, whole)
def settle(fleet: Fleet, i: int) -> None:
    """Initialise the firmware after power-on.

    The filters start as after a long time level, the estimate at the initial place.
    """
    fw = fleet[i]
    fw.delays[10] = 1.0 - ACC_B
    fw.delays[11] = ACC_B - ACC_A2
    estimator.start_estimate(fw)
    planner.take_state(fw)


@kernel()
def _choose_setpoint(fw: Record) -> Record:
    """Return the set-point to fly: changed to avoid peers, or level if set-points are missing.

    Source of the order: crazyflie-firmware, stabilizer.c.
    """
    sp = fw.wanted
    if fw.avoids:
        voronoi.avoid_peers(fw)
        sp = fw.avoided
    if fw.state == SUPERVISOR_STATES.level_out:
        write_level_setpoint(fw, sp)
        sp = fw.level
    return sp


@kernel()
def _run_controller(fw: Record) -> None:
    """Run the chosen controller and the mixing of motors, at 500 Hz; Brescianini's at 1 kHz.

    A user's law is only marked as due here; it has written its output since the last pass.
    """
    sp = _choose_setpoint(fw)
    if fw.controller == CONTROLLER_KINDS.pid:
        cascade.control(fw, sp)
    elif fw.controller == CONTROLLER_KINDS.mellinger:
        mellinger.control(fw, sp)
    elif fw.controller == CONTROLLER_KINDS.lee:
        lee.control(fw, sp)
    elif fw.controller == CONTROLLER_KINDS.indi:
        indi.control(fw, sp)
    elif fw.controller == CONTROLLER_KINDS.brescianini:
        brescianini.control(fw, sp)
    else:
        fw.law_due = 1
    mixing.drive_motors(fw, supervisor.may_fly(fw))


@kernel()
def stabilize(
    fw: Record, gx: float, gy: float, gz: float, ax: float, ay: float, az: float
) -> None:
    """Advance the drone's firmware by 1 ms and write its motor commands.

    fw.motors are the shares of the full thrust of the four motors. If fw.law_due is 1 afterwards,
    `Onboard.obey_law` must run the user's controller before the next ms.
    fw: memory of the drone, with its battery voltage in fw.vbat, V, and the height above the sea
        that its barometer measures in fw.asl, m
    gx, gy, gz: rad/s, body: readings of the gyroscope
    ax, ay, az: m/s2, body: specific force
    A firmware with a self-test that has failed does nothing (system.c: its tasks wait).
    """
    if fw.self_tested == 0:
        fw.tick += 1
        return
    fw.gx = _filter_gyroscope(fw, 0, gx)
    fw.gy = _filter_gyroscope(fw, 1, gy)
    fw.gz = _filter_gyroscope(fw, 2, gz)
    if fw.acc_count < SENSOR_SETTINGS.calibration_samples:
        _weigh(fw, ax, ay, az)
    c = fw.acc_scale
    fw.ax = _filter_accelerometer(fw, 0, c * ax)
    fw.ay = _filter_accelerometer(fw, 1, c * ay)
    fw.az = _filter_accelerometer(fw, 2, c * az)
    fw.vbat_low += mixing.POWER_DISTRIBUTION.voltage_low_pass * (fw.vbat - fw.vbat_low)
    if fw.start_propellers | fw.start_battery | fw.test_state:
        g = SENSOR_SETTINGS.g_per_acceleration
        health.run_test(fw, g * c * ax, g * c * ay)
        mixing.compute_shares(fw)
        fw.tick += 1
        return
    if fw.estimator == ESTIMATOR_KINDS.kalman:
        estimator.collect_samples(fw)
    else:
        complementary.estimate(fw)
    tick = fw.tick
    if tick % TASK_PERIODS.position == 0:
        estimator.predict(fw)
        planner.update(fw)
        if tick % TASK_PERIODS.supervisor == 0:
            supervisor.update(fw)
    if (
        tick % TASK_PERIODS.attitude == 0
        or fw.controller == CONTROLLER_KINDS.brescianini
    ):
        _run_controller(fw)
        mixing.compute_shares(fw)
    fw.tick = tick + 1


@kernel(rows, whole)
def forget(fleet: Fleet, i: int) -> None:
    """Reset all controllers; there is no thrust until their next pass."""
    fw = fleet[i]
    cascade.reset(fw)
    mellinger.reset(fw)
    lee.reset(fw)
    indi.reset(fw)
    fw.output = 0
    fw.thrust = 0.0
    fw.roll_out = 0.0
    fw.pitch_out = 0.0
    fw.yaw_out = 0.0


@kernel(rows, real, real, real, real, real, real, real)
def run(
    fleet: Fleet,
    ms: float,
    gx: float,
    gy: float,
    gz: float,
    ax: float,
    ay: float,
    az: float,
) -> None:
    """Run every drone for some ms with constant sensor readings, as on a test bench."""
    for i in range(fleet.shape[0]):
        for _ in range(int(ms)):
            stabilize(fleet[i], gx, gy, gz, ax, ay, az)
