"""The delay margin of a control loop, by which gains are accepted or refused.

Near hover a drone is, along one horizontal axis, x'' = g theta, theta' = w, w = W(s) w_c, and the
command is w_c = -KR (theta - theta_d), theta_d = -(kp x + kv v_f + ki int x) / g, with v_f the
velocity behind a first-order filter. W is a lag, 1 / (lag s + 1), or the rate loop on board with
the rotors behind it.

Polynomials are coefficients with the highest power first. A loop is (numerator, denominator) of
L(s).
"""

import math
from dataclasses import dataclass
from functools import reduce
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from crazychoir.control.gains import HOLD_DELAY, Gains
from crazychoir.platforms import Platform, rotor_speed

Plant = Literal["motors", "lightweight"]
Polynomial = npt.NDArray[np.floating[Any]]
Loop = tuple[Polynomial, Polynomial]
REQUIRED_DELAY_MARGIN = 0.040  # s, the delay margin that all gains that ship must keep
STANDARD_GAIN_MARGINS = {
    "motors": {
        "paper": 0.103,
        "cf21": 0.103,
        "cf21plus": 0.105,
        "cf21thrust": 0.109,
        "cf21bl": 0.102,
    },
    "lightweight": {
        "paper": 0.040,
        "cf21": 0.040,
        "cf21plus": 0.064,
        "cf21thrust": 0.071,
        "cf21bl": 0.103,
    },
}
"""Delay margin in s of STANDARD_GAINS by plant and platform.

It is checked with 1.3 times the identified lag; see `compute_delay_margin`.
"""
SLOWEST_RATE_LAG = 0.086
"""Lag in s of the body rates of the slowest platform.

It is the rotor lag of a Crazyflie 2.1, identified in the drone-models package.
"""


def _make_outer_loop(kp: float, kv: float, cutoff: float, ki: float = 0.0) -> Loop:
    """Return (kv s F(s) + kp + ki / s) / s^2 with F = cutoff / (s + cutoff).

    An infinite cutoff is no filter.
    """
    low = np.array([1.0]) if math.isinf(cutoff) else np.array([1.0 / cutoff, 1.0])
    place = np.polymul([kp, ki] if ki else [kp], low)
    damping = np.array([kv, 0.0, 0.0] if ki else [kv, 0.0])
    return np.polyadd(place, damping), np.polymul(
        [1.0, 0.0, 0.0, 0.0] if ki else [1.0, 0.0, 0.0], low
    )


def make_lag_loop(lag: float) -> Loop:
    """Return W(s) = 1 / (lag s + 1)."""
    return np.array([1.0]), np.array([lag, 1.0])


def compute_rate_authority(platform: Platform, axis: int) -> float:
    """Return b: the angular acceleration in rad/s2 that a rate control's output of 1 makes about this axis.

    It is what remains once the rotors have followed. The output is in the firmware's units over deg/s, so that b times
    a gain of its rate control is in 1/s. The reaction torque is the slope of the torque curve at hover.

    platform: of the drone
    axis: 0, 1, 2 for roll, pitch, yaw
    """
    newton = platform.firmware.thrust_max / 65535.0 * math.degrees(1.0)
    if axis < 2:  # half of the command goes to each side
        return 2.0 * platform.arm * newton / platform.inertia[axis]
    rotor = platform.rotor
    r = rotor_speed(rotor, platform.weight / 4.0)
    slope = (rotor.torque[0] + 2.0 * rotor.torque[1] * r) / (
        rotor.thrust[0] + 2.0 * rotor.thrust[1] * r
    )
    return 4.0 * slope * newton / platform.inertia[2]


def make_rate_loop(platform: Platform, axis: int, worse: float = 1.0) -> Loop:
    """Return W(s) of the rate loop on board.

        W = b (kp s + ki) / (lag s^3 + (1 + b kd) s^2 + b kp s + b ki)

    b is of `compute_rate_authority`. kp, ki and kd are those of the firmware's rate controller, P on the error, D on
    the rate.

    platform: of the drone
    axis: 0, 1, 2 for roll, pitch, yaw
    worse: factor on the lag of the rotors
    """
    firmware = platform.firmware
    kp, ki, kd = firmware.yaw_rate_pid if axis == 2 else firmware.rate_pid
    b = compute_rate_authority(platform, axis)
    return np.array([b * kp, b * ki]), np.array(
        [worse * platform.rotor.lag, 1.0 + b * kd, b * kp, b * ki]
    )


@dataclass(frozen=True)
class InnerLoop:
    """The inner loop between a commanded acceleration and the drone's acceleration."""

    kr: float
    """1/s."""
    lag: float = SLOWEST_RATE_LAG
    """s, of the body rates."""
    cutoff: float = 50.0
    """rad/s, of the velocity filter; inf for none."""
    lead: float = 0.0
    """Share of the feed-forward of the rate of the desired attitude (FlatnessAccelerationCtrl)."""
    lead_cutoff: float = 50.0
    """rad/s, of that feed-forward."""
    rates: Loop | None = None
    """W(s) of the body rates, if it is known better than by the lag; else None."""

    @property
    def attitude(self) -> Loop:
        """KR + lead s c / (s + c): from the desired attitude to the rate command."""
        c = self.lead_cutoff
        return np.array([self.kr + self.lead * c, self.kr * c]), np.array([1.0, c])

    @property
    def response(self) -> Loop:
        """W(s)."""
        return make_lag_loop(self.lag) if self.rates is None else self.rates


def make_command_loop(kp: float, kv: float, inner: InnerLoop, ki: float = 0.0) -> Loop:
    """Return the loop opened at the rate command.

        L(s) = (KR + (KR + lead s G) (kv s F + kp + ki / s) / s^2) W / s

    A delay of commands or of the whole measurement enters here. F and G are the first-order
    low-passes of the velocity and of the lead.

    kp: 1/s2
    kv: 1/s
    inner: the inner loop
    ki: 1/s3
    """
    num, den = _make_outer_loop(kp, kv, inner.cutoff, ki)
    att, low = inner.attitude
    over, under = inner.response
    command = np.polyadd(np.polymul(num, att), inner.kr * np.polymul(den, low))
    return np.polymul(command, over), _multiply_polynomials(den, low, under, [1.0, 0.0])


def make_guidance_loop(kp: float, kv: float, inner: InnerLoop) -> Loop:
    """Return the loop opened at the acceleration reference.

        L(s) = (kv s F + kp) / s^2 * (KR + lead s G) W / (s + KR W)

    A delay of guidance or of the neighbours' data enters here. Symbols as in `make_command_loop`.
    """
    num, den = _make_outer_loop(kp, kv, inner.cutoff)
    att, low = inner.attitude
    over, under = inner.response
    closed = np.polyadd(np.polymul(under, [1.0, 0.0]), inner.kr * over)
    return _multiply_polynomials(num, att, over), _multiply_polynomials(
        den, low, closed
    )


def make_vertical_loop(
    kp: float,
    kv: float,
    lag: float = SLOWEST_RATE_LAG,
    cutoff: float = 50.0,
    ki: float = 0.0,
) -> Loop:
    """Return the loop of the height, on which the thrust acts without attitude.

    L(s) = (kv s F + kp + ki / s) / (s^2 (lag s + 1)),   lag of the thrust
    """
    num, den = _make_outer_loop(kp, kv, cutoff, ki)
    return num, np.polymul(den, [lag, 1.0])


def make_heading_loop(kr: float, rates: Loop) -> Loop:
    """Return the loop of the yaw: L(s) = KR W / s."""
    return kr * rates[0], np.polymul(rates[1], [1.0, 0.0])


def _multiply_polynomials(*factors: Any) -> Polynomial:
    """Return the product of polynomials."""
    return reduce(np.polymul, factors)


def compute_delay_margin(
    gains: Gains, platform: Platform, plant: Plant = "motors", worse: float = 1.3
) -> float:
    """Return the smallest delay margin in s of a drone that tracks with these gains.

    Half a tick of 100 Hz is already spent.

    gains: the gains
    platform: of the drone
    plant: "motors": behind its rate loops and rotors. "lightweight": behind a lag of the rates, and
        of the thrust, as long as that of its rotors, which is slower than either.
    worse: factor by which the lag is longer than identified
    """
    lag = worse * platform.rotor.lag
    loops = []
    for axis in (0, 1):
        rates = (
            make_rate_loop(platform, axis, worse)
            if plant == "motors"
            else make_lag_loop(lag)
        )
        inner = InnerLoop(gains.kr[axis], rates=rates)
        loops.append(
            make_command_loop(gains.kp[axis], gains.kv[axis], inner, gains.ki_trim)
        )
    loops.append(make_vertical_loop(gains.kp[2], gains.kv[2], lag, ki=gains.ki_thrust))
    loops.append(
        make_heading_loop(
            gains.kr[2],
            make_rate_loop(platform, 2, worse)
            if plant == "motors"
            else make_lag_loop(lag),
        )
    )
    return max(min(map(find_delay_margin, loops)) - HOLD_DELAY, 0.0)


def is_stable(loop: Loop) -> bool:
    """Return whether all roots of den + num are in the open left half plane."""
    return bool(np.all(np.roots(np.polyadd(*loop)).real < 0.0))


def find_delay_margin(loop: Loop) -> float:
    """Return the smallest delay in s that makes the closed loop unstable.

        min over |L(jw)| = 1 of (pi + arg L(jw)) / w,  the angle taken in [0, 2 pi)

    The crossings are the positive roots of |num(jw)|^2 - |den(jw)|^2, a polynomial in w^2.
    Returns 0 if the loop is already unstable, inf if no delay makes it so.
    """
    if not is_stable(loop):
        return 0.0
    num, den = loop
    squares = np.roots(np.polysub(_square_magnitude(num), _square_magnitude(den)))
    w = np.sqrt(
        [s.real for s in squares if s.real > 0.0 and abs(s.imag) < 1e-7 * abs(s)]
    )
    phase = np.mod(
        np.angle(np.polyval(num, 1j * w) / np.polyval(den, 1j * w)) + math.pi,
        2.0 * math.pi,
    )
    return float(np.min(phase / w, initial=math.inf))


def _square_magnitude(p: Polynomial) -> Polynomial:
    """Return |p(jw)|^2 as a polynomial in w^2: p(s) p(-s) at s^2 = -w^2, for real coefficients."""
    mirrored = p * (-1.0) ** np.arange(len(p) - 1, -1, -1)
    even = np.polymul(p, mirrored)[::2]
    return even * (-1.0) ** np.arange(len(even) - 1, -1, -1)
