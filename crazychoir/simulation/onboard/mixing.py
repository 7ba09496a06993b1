"""Power distribution: what a controller wants, as four motors, at the battery's present voltage.

Motors in a cross: 0 front right, 1 back right, 2 back left, 3 front left; 0 and 2 push the body to a negative yaw.
"""

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.simulation.onboard.record import FORCE_TORQUE, LEGACY, Record

FULL = 65535.0
PER_FULL = 1.0 / FULL
LOW_PASS = 0.01  # of the battery's voltage, a ms
STEADY = 1e-9  # relative, of the battery against its low-pass


@kernel()
def _legacy(fw: Record) -> None:
    """m = T -/+ roll/2 +/- pitch/2 +/- yaw, with halves cut to integers; pitch positive nose up."""
    r = float(np.trunc(0.5 * fw.roll_out))
    p = float(np.trunc(0.5 * fw.pitch_out))
    t = fw.thrust
    y = fw.yaw_out
    fw.request[0] = t - r + p + y
    fw.request[1] = t - r - p - y
    fw.request[2] = t + r - p + y
    fw.request[3] = t + r + p - y


@kernel()
def _force_torque(fw: Record) -> None:
    """f = T/4 -/+ tx/(4 a) -/+ ty/(4 a) -/+ tz/(4 k), not below 0; a: arm along x, m; k: torque of 1 N, m."""
    per_newton = FULL / fw.thrust_max
    t = 0.25 * fw.force
    r = 0.25 * fw.torque_x / fw.arm
    p = 0.25 * fw.torque_y / fw.arm
    y = 0.25 * fw.torque_z / fw.torque_ratio
    fw.request[0] = max(t - r - p - y, 0.0) * per_newton
    fw.request[1] = max(t - r + p + y, 0.0) * per_newton
    fw.request[2] = max(t + r + p - y, 0.0) * per_newton
    fw.request[3] = max(t + r - p + y, 0.0) * per_newton


@kernel()
def _cap(fw: Record) -> None:
    """Take the excess of the highest over 65535 from all, so that the torques stay; then none below idle."""
    m = fw.request
    excess = max(max(max(m[0], m[1]), max(m[2], m[3])) - FULL, 0.0)
    for i in range(4):
        m[i] = max(m[i] - excess, fw.idle)


@kernel()
def _wish(fw: Record, allowed: bool) -> None:
    """What the controller requests; all 0 where the supervisor does not allow motors."""
    if not allowed:
        for i in range(4):
            fw.request[i] = 0.0
        return
    if fw.output == LEGACY:
        _legacy(fw)
    elif fw.output == FORCE_TORQUE:
        _force_torque(fw)
    else:
        for i in range(4):
            fw.request[i] = fw.law_motors[i]
    _cap(fw)


@kernel()
def distribute(fw: Record, allowed: bool) -> None:
    """The request of each motor, 0..65535; motorPowerSet has the last word, whoever allows what."""
    _wish(fw, allowed)
    if fw.power_set == 1:
        fw.request[0], fw.request[1], fw.request[2], fw.request[3] = (
            fw.power_1,
            fw.power_2,
            fw.power_3,
            fw.power_4,
        )
    elif fw.power_set == 2:
        for i in range(4):
            fw.request[i] = fw.power_1


@kernel()
def _thrust(fw: Record, v: float) -> float:
    """N of one motor at v V: c0 + c1 v + c2 v^2 + c3 v^3."""
    f: float = fw.c0 + v * (fw.c1 + v * (fw.c2 + v * fw.c3))
    return f


@kernel()
def _voltage(fw: Record, v: float, request: float) -> float:
    """V that make the requested N, thrust_min at least: a pass of Newton's method from v, the last answer.

    Its error counts by the battery's distance from its low-pass only. The curve rises everywhere.
    """
    f: float = max(request * (fw.thrust_max * PER_FULL), fw.thrust_min)
    slope: float = fw.c1 + v * (2.0 * fw.c2 + 3.0 * v * fw.c3)
    return v - (_thrust(fw, v) - f) / slope


@kernel()
def _share(fw: Record, v: float, request: float, ratio: float) -> float:
    """Share of the full thrust of a motor that v V would make give its request, at `ratio` times that voltage."""
    f = request * (fw.thrust_max * PER_FULL)
    e = ratio - 1.0
    more = (
        v
        * e
        * (
            fw.c1
            + v * (fw.c2 * (1.0 + ratio) + v * fw.c3 * (1.0 + ratio * (1.0 + ratio)))
        )
    )
    g = f + more if f < _thrust(fw, fw.vbat_low) else _thrust(fw, fw.vbat)
    share: float = 0.0 if f < fw.thrust_min else max(g, 0.0) * (1.0 / fw.thrust_max)
    return share


@kernel()
def compensate(fw: Record) -> None:
    """Share of the full thrust that each motor gives.

        f = request / 65535 thrust_max, 0 below thrust_min;  duty = V(f) / v_low <= 1;  share = F(duty v) / thrust_max

    V inverts F, the curve of the motor;  v: the battery's voltage, v_low: low-passed.
    All four are computed before one is written, without branches: none waits for another.
    """
    r = fw.request
    v = fw.volts
    ratio = fw.vbat / fw.vbat_low
    if abs(ratio - 1.0) < STEADY:
        ratio = 1.0
    else:
        v[0], v[1], v[2], v[3] = (
            _voltage(fw, v[0], r[0]),
            _voltage(fw, v[1], r[1]),
            _voltage(fw, v[2], r[2]),
            _voltage(fw, v[3], r[3]),
        )
    fw.motors[0], fw.motors[1], fw.motors[2], fw.motors[3] = (
        _share(fw, v[0], r[0], ratio),
        _share(fw, v[1], r[1], ratio),
        _share(fw, v[2], r[2], ratio),
        _share(fw, v[3], r[3], ratio),
    )
