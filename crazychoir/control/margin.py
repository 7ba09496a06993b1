"""How much more delay a loop bears: every gain that ships is judged by this before it flies.

Near hover a drone is, along one horizontal axis, x'' = g theta, theta' = w, lag w' = w_c - w, and the command is
w_c = -KR (theta - theta_d), theta_d = -(kp x + kv v_f) / g, with v_f the velocity behind a first-order filter.
Polynomials are coefficients with the highest power first; a loop is (numerator, denominator) of L(s).
"""

import math
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
import numpy.typing as npt

Polynomial = npt.NDArray[np.floating[Any]]
Loop = tuple[Polynomial, Polynomial]
REQUIRED = 0.040  # s, the delay margin that every gain that ships must keep
HOLD = 0.005  # s, half a tick at 100 Hz: the delay of holding commands, already spent
RATE_LAG = 0.086  # s, the slowest platform: rotor lag of a Crazyflie 2.1 (identified in the drone-models package)


def _outer(kp: float, kv: float, cutoff: float) -> Loop:
    """(kv s F(s) + kp) / s^2 with F = cutoff / (s + cutoff); an infinite cutoff is no filter."""
    if math.isinf(cutoff):
        return np.array([kv, kp]), np.array([1.0, 0.0, 0.0])
    return np.array([kv * cutoff + kp, kp * cutoff]), np.array([1.0, cutoff, 0.0, 0.0])


@dataclass(frozen=True)
class Inner:
    """What lies between an acceleration and the drone that gives it.

    kr: 1/s;  lag: s, of the body rates;  cutoff: rad/s, of the velocity filter, inf for none;
    lead, lead_cutoff: rad/s, feed-forward of the rate of the desired attitude (FlatnessAccelerationCtrl).
    """

    kr: float
    lag: float = RATE_LAG
    cutoff: float = 50.0
    lead: float = 0.0
    lead_cutoff: float = 50.0

    @property
    def attitude(self) -> Loop:
        """KR + lead s c / (s + c): from the desired attitude to the rate command."""
        c = self.lead_cutoff
        return np.array([self.kr + self.lead * c, self.kr * c]), np.array([1.0, c])


def command_loop(kp: float, kv: float, inner: Inner) -> Loop:
    """The loop opened at the rate command: a delay of commands or of the whole measurement enters here.

        L(s) = (KR + (KR + lead s G) (kv s F + kp) / s^2) / (s (lag s + 1))

    kp: 1/s2;  kv: 1/s;  F, G: first-order low-passes of the velocity and of the lead.
    """
    num, den = _outer(kp, kv, inner.cutoff)
    att, low = inner.attitude
    return np.polyadd(np.polymul(num, att), inner.kr * np.polymul(den, low)), _product(den, low, [inner.lag, 1.0, 0.0])


def guidance_loop(kp: float, kv: float, inner: Inner) -> Loop:
    """The loop opened at the acceleration reference: a delay of guidance or of the neighbours' data enters here.

        L(s) = (kv s F + kp) / s^2 * (KR + lead s G) / (lag s^2 + s + KR)

    Symbols as in `command_loop`.
    """
    num, den = _outer(kp, kv, inner.cutoff)
    att, low = inner.attitude
    return np.polymul(num, att), _product(den, low, [inner.lag, 1.0, inner.kr])


def vertical_loop(kp: float, kv: float, lag: float = RATE_LAG, cutoff: float = 50.0) -> Loop:
    """Height: thrust acts without attitude, L(s) = (kv s F + kp) / (s^2 (lag s + 1)), lag of the thrust."""
    num, den = _outer(kp, kv, cutoff)
    return num, np.polymul(den, [lag, 1.0])


def heading_loop(kr: float, lag: float = RATE_LAG) -> Loop:
    """Yaw: L(s) = KR / (s (lag s + 1))."""
    return np.array([kr]), np.array([lag, 1.0, 0.0])


def _product(*factors: Any) -> Polynomial:
    return reduce(np.polymul, factors)


def stable(loop: Loop) -> bool:
    """Are all roots of den + num in the open left half plane?"""
    return bool(np.all(np.roots(np.polyadd(*loop)).real < 0.0))


def delay_margin(loop: Loop) -> float:
    """Smallest delay in s that makes the closed loop unstable; 0 if it is unstable already, inf if no delay does.

        min over |L(jw)| = 1 of (pi + arg L(jw)) / w,  the angle taken in [0, 2 pi)

    The crossings are the positive roots of |num(jw)|^2 - |den(jw)|^2, a polynomial in w^2.
    """
    if not stable(loop):
        return 0.0
    num, den = loop
    squares = np.roots(np.polysub(_squared_magnitude(num), _squared_magnitude(den)))
    w = np.sqrt([s.real for s in squares if s.real > 0.0 and abs(s.imag) < 1e-7 * abs(s)])
    phase = np.mod(np.angle(np.polyval(num, 1j * w) / np.polyval(den, 1j * w)) + math.pi, 2.0 * math.pi)
    return float(np.min(phase / w, initial=math.inf))


def _squared_magnitude(p: Polynomial) -> Polynomial:
    """|p(jw)|^2 as a polynomial in w^2, of p(s) with real coefficients: p(s) p(-s) at s^2 = -w^2."""
    mirrored = p * (-1.0) ** np.arange(len(p) - 1, -1, -1)
    even = np.polymul(p, mirrored)[::2]
    return even * (-1.0) ** np.arange(len(even) - 1, -1, -1)
