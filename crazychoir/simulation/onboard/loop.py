"""One ms on board of one drone: sensors, estimator, commander, supervisor, controller, motors."""

import math

from crazychoir.numerics.kernels import kernel, real
from crazychoir.numerics.math3d import GRAVITY
from crazychoir.simulation.onboard import (
    cascade,
    estimator,
    lee,
    mellinger,
    mixing,
    planner,
    supervisor,
)
from crazychoir.simulation.onboard.commander import leveled
from crazychoir.simulation.onboard.record import (
    LEE,
    MELLINGER,
    PID,
    Fleet,
    Record,
    rows,
    whole,
)

ATTITUDE = 2  # ms: period of attitude and rate control, 500 Hz
POSITION = 10  # ms: period of estimator, position control and planner, 100 Hz
SUPERVISOR = 40  # ms: period of the supervisor, 25 Hz


def _butterworth(hertz: float) -> tuple[float, float, float]:
    """Return b0, a1, a2 of a low-pass of order 2 at 1 kHz (b1 = 2 b0, b2 = b0)."""
    c = math.tan(math.pi * hertz / 1000.0)
    n = 1.0 / (1.0 + math.sqrt(2.0) * c + c * c)
    return c * c * n, 2.0 * (c * c - 1.0) * n, (1.0 - math.sqrt(2.0) * c + c * c) * n


GYRO_B, GYRO_A1, GYRO_A2 = _butterworth(80.0)
ACC_B, ACC_A1, ACC_A2 = _butterworth(30.0)
SETTLED = 100  # ms after power-on before the firmware weighs itself
STANDING = 200  # samples of the accelerometer for that
DEGREES = 180.0 / math.pi  # deg a rad
PER_G = 1.0 / GRAVITY  # g a m/s2


@kernel()
def _gyro(fw: Record, k: int, raw: float) -> float:
    """Filter the gyroscope's axis k with a low-pass of 80 Hz; return deg/s."""
    d = fw.delays
    value = raw * DEGREES
    y: float = GYRO_B * value + d[2 * k]
    d[2 * k] = 2.0 * GYRO_B * value - GYRO_A1 * y + d[2 * k + 1]
    d[2 * k + 1] = GYRO_B * value - GYRO_A2 * y
    return y


@kernel()
def _acc(fw: Record, k: int, raw: float) -> float:
    """Filter the accelerometer's axis k with a low-pass of 30 Hz; return g."""
    d = fw.delays
    value = raw * PER_G
    i = 6 + 2 * k
    y: float = ACC_B * value + d[i]
    d[i] = 2.0 * ACC_B * value - ACC_A1 * y + d[i + 1]
    d[i + 1] = ACC_B * value - ACC_A2 * y
    return y


@kernel()
def _weigh(fw: Record, ax: float, ay: float, az: float) -> None:
    """Calibrate the accelerometer: scale the mean of STANDING samples to 1 g.

    The samples are taken some time after power-on, while the drone stands with its motors off.
    """
    m = fw.request
    if fw.tick < SETTLED or max(max(m[0], m[1]), max(m[2], m[3])) > fw.idle:
        return
    weight = math.sqrt(ax * ax + ay * ay + az * az)
    if abs(weight - GRAVITY) < 0.1 * GRAVITY:
        fw.acc_sum += weight
        fw.acc_count += 1.0
        if fw.acc_count >= STANDING:
            fw.acc_scale = GRAVITY * fw.acc_count / fw.acc_sum


@kernel(rows, whole)
def settle(fleet: Fleet, i: int) -> None:
    """Initialise the firmware after power-on.

    The filters start as after a long time level, the estimate at the initial place.
    """
    fw = fleet[i]
    fw.delays[10] = 1.0 - ACC_B
    fw.delays[11] = ACC_B - ACC_A2
    estimator.begin(fw)
    planner.take_state(fw)


@kernel()
def _control(fw: Record) -> None:
    """Run the chosen controller and the mixing of motors, at 500 Hz.

    A user's law is only marked as due here; it has written its output since the last pass.
    """
    sp = fw.level if fw.state == supervisor.LEVEL_OUT else fw.wanted
    if fw.state == supervisor.LEVEL_OUT:
        leveled(fw)
    if fw.controller == PID:
        cascade.control(fw, sp)
    elif fw.controller == MELLINGER:
        mellinger.control(fw, sp)
    elif fw.controller == LEE:
        lee.control(fw, sp)
    else:
        fw.law_due = 1
    mixing.distribute(fw, supervisor.may_fly(fw))


@kernel()
def stabilize(
    fw: Record, gx: float, gy: float, gz: float, ax: float, ay: float, az: float
) -> None:
    """Advance the drone's firmware by 1 ms and write its motor commands.

    fw.motors are the shares of the full thrust of the four motors. If fw.law_due is 1 afterwards,
    `Onboard.obey_law` must run the user's controller before the next ms.
    fw: memory of the drone, with its battery voltage in fw.vbat, V
    gx, gy, gz: rad/s, body: readings of the gyroscope
    ax, ay, az: m/s2, body: specific force
    """
    fw.gx, fw.gy, fw.gz = _gyro(fw, 0, gx), _gyro(fw, 1, gy), _gyro(fw, 2, gz)
    if fw.acc_count < STANDING:
        _weigh(fw, ax, ay, az)
    c = fw.acc_scale
    fw.ax, fw.ay, fw.az = _acc(fw, 0, c * ax), _acc(fw, 1, c * ay), _acc(fw, 2, c * az)
    estimator.collect(fw)
    fw.vbat_low += mixing.LOW_PASS * (fw.vbat - fw.vbat_low)
    tick = fw.tick
    if tick % ATTITUDE == 0:
        if tick % POSITION == 0:
            estimator.predict(fw)
            planner.update(fw)
            if tick % SUPERVISOR == 0:
                supervisor.update(fw)
        _control(fw)
        mixing.compensate(fw)
    fw.tick = tick + 1


@kernel(rows, whole)
def forget(fleet: Fleet, i: int) -> None:
    """Reset all controllers; there is no thrust until their next pass."""
    fw = fleet[i]
    cascade.reset(fw)
    mellinger.reset(fw)
    lee.reset(fw)
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
