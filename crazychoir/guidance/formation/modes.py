"""The modes of a formation with the dynamics of its drones: their decay and their delay margin."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.control.gains import FORMATION_GAINS, HOLD_DELAY, Gains
from crazychoir.control.margin import (
    SLOWEST_RATE_LAG,
    InnerLoop,
    Loop,
    find_delay_margin,
    make_command_loop,
    make_guidance_loop,
    make_rate_loop,
    make_vertical_loop,
)
from crazychoir.platforms import Platform
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class FormationDelays:
    """Delays that the analysis of a formation's modes assumes and checks."""

    state_delay: float = 0.01
    """s: a received acceleration was commanded one tick before the state beside it."""
    rotor_lag_factor: float = 1.3
    """Factor on the identified lag of the rotors."""
    largest_age: float = 0.15
    """s: larger ages are not checked."""


FORMATION_DELAYS = FormationDelays()


LEAST_HORIZONTAL_PART = 1e-6
"""A mode with a smaller horizontal part moves in height only."""
NYQUIST_FREQUENCIES = np.concatenate(
    [-np.geomspace(500.0, 1e-3, 3000), np.geomspace(1e-3, 500.0, 3000)]
)
"""rad/s: frequencies of the Nyquist plot."""

Complex = npt.NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True)
class AccelerationChain:
    """The dynamics between the acceleration that a law wants and the acceleration of the drone."""

    gains: Gains = FORMATION_GAINS
    """Gains of the control behind the law."""
    lag: float = SLOWEST_RATE_LAG
    """s: lag of the body rates, and of the thrust."""
    rates: Loop | None = None
    """W(s) of a rate loop on board. None: the body rates have only the lag."""

    @classmethod
    def of_motors(cls, gains: Gains, platform: Platform) -> "AccelerationChain":
        """Return the chain of a drone with a rate loop on board.

        Its rotors are slower than identified.
        """
        return cls(
            gains,
            FORMATION_DELAYS.rotor_lag_factor * platform.rotor.lag,
            make_rate_loop(platform, 0, FORMATION_DELAYS.rotor_lag_factor),
        )

    @property
    def inner(self) -> InnerLoop:
        """The attitude loop of roll and pitch."""
        gains = self.gains
        return InnerLoop(
            min(gains.kr[:2]),
            self.lag,
            lead=gains.lead,
            lead_cutoff=gains.lead_cutoff,
            rates=self.rates,
        )


def compute_slowest_mode(eigenvalues: Sequence[complex], kp: float, kv: float) -> float:
    """Return the decay rate of the slowest mode in 1/s.

    It is the smallest -Re s over s^2 + kv l s + kp l = 0.

    eigenvalues: the values l.
    kp: 1/s2.
    kv: 1/s.
    """
    return float(min(-np.roots([1.0, kv * e, kp * e]).real.max() for e in eigenvalues))


def compute_slowest_normalised_mode(
    eigenvalues: Sequence[complex], kp: float, kv: float
) -> float:
    """Return the decay rate of the slowest mode of the normalised law in 1/s.

        s^2 + kv s + kp = 0,   or   e^(s h) = 1 - l

    The second equation describes how commanded accelerations pass from one neighbour to the next in
    a tick h.
    """
    through = min(
        -math.log(max(abs(1.0 - e), 1e-12)) / FORMATION_DELAYS.state_delay
        for e in eigenvalues
    )
    return min(compute_slowest_mode([1.0], kp, kv), through)


def compute_mode_margin(
    eigenvalues: Sequence[float],
    horizontal: Sequence[bool],
    kp: float,
    kv: float,
    chain: AccelerationChain = AccelerationChain(),
) -> float:
    """Return the smallest delay margin in s over the modes l, each with the gains kp l and kv l.

    A horizontal mode acts through the attitude. Its delay may enter with the neighbours' data
    (guidance_loop) or with all data (command_loop). A mode in height alone acts through the thrust,
    which has the same lag. Half a tick of 100 Hz is subtracted. Velocities pass a filter of 50
    rad/s.

    eigenvalues: the values l.
    horizontal: whether each mode moves horizontally.
    kp: 1/s2.
    kv: 1/s.
    chain: dynamics of the drones.
    """
    margin = math.inf
    for e, tilts in zip(eigenvalues, horizontal, strict=True):
        if tilts:
            loops = [
                make_command_loop(kp * e, kv * e, chain.inner),
                make_guidance_loop(kp * e, kv * e, chain.inner),
            ]
        else:
            loops = [make_vertical_loop(kp * e, kv * e, chain.lag)]
        margin = min(margin, *map(find_delay_margin, loops))
        if margin <= HOLD_DELAY:
            return 0.0
    return margin - HOLD_DELAY


def compute_age_margin(
    eigenvalues: Sequence[complex],
    kp: float,
    kv: float,
    chain: AccelerationChain,
    moving: bool = False,
) -> float:
    """Return how much older, in s, the neighbours' data may be in the normalised law.

    The bound holds for every mode l.

    It is 0 if the law is unstable already.

        s^2 (1 - m e^(-(d + h) s)) + G(s) (kp + kv s F(s)) (1 - m e^(-(d + g) s)) = 0,   m = 1 - l

    d is that age. h is one tick, by which a_j is older than p_j and v_j. g = h if the law takes p_j
    and v_j from the tick of a_j, and g = 0 if leaders move and it takes the newest. G is the
    attitude loop or the thrust, F the velocity filter. Stability follows from Nyquist: along the
    imaginary axis the phase of the left side over its first bracket turns twice by pi.

    If g = h the brackets are equal, so all modes are alike and bear any age. If g = 0 and the
    values are real, the number of turns changes with m only where the equation has a root on the
    axis: it is counted next to these places.

    eigenvalues: the values l; if the leaders do not move, some of them suffice.
    kp: 1/s2.
    kv: 1/s.
    chain: dynamics of the drones.
    moving: the leaders move.
    """
    lags = (
        0.0,
        0.005,
        0.01,
        0.02,
        0.03,
        0.04,
        0.06,
        0.08,
        0.1,
        FORMATION_DELAYS.largest_age,
    )
    m = 1.0 - np.asarray(eigenvalues)
    older = 0.0 if moving else FORMATION_DELAYS.state_delay
    if not moving:
        m = m[:1]
    responses = [_compute_attitude_response(chain), _compute_thrust_response(chain)]
    borne = 0.0
    for d in lags:
        for g in responses:
            law = g * _compute_law_response(kp, kv)
            decisive = m if np.iscomplexobj(m) else _choose_decisive(m, law, d, older)
            if not all(_is_stable(each, law, d, older) for each in decisive):
                return borne
        borne = d
    return borne


def _compute_law_response(kp: float, kv: float) -> Complex:
    """Return kp + kv s F(s) at the NYQUIST_FREQUENCIES."""
    s = 1j * NYQUIST_FREQUENCIES
    response: Complex = kp + kv * s * 50.0 / (s + 50.0)
    return response


def _is_stable(m: complex, law: Complex, d: float, older: float) -> bool:
    """Return whether the phase of the mode turns as often as that of a stable one."""
    s = 1j * NYQUIST_FREQUENCIES
    share = (1.0 - m * np.exp(-(d + older) * s)) / (
        1.0 - m * np.exp(-(d + FORMATION_DELAYS.state_delay) * s)
    )
    phase = np.unwrap(np.angle(s**2 + law * share))
    turns = (phase[-1] - phase[0]) / (2.0 * math.pi)
    return bool(np.round(turns) == 1)


def _choose_decisive(m: Vec, law: Complex, d: float, older: float) -> Vec:
    """Return the values of m that decide whether all of them are stable.

    These are the smallest, the largest, and those next to each m for which the equation has a root
    on the imaginary axis:

        m(w) = (s^2 + law) / (s^2 e^(-(d + h) s) + law e^(-(d + g) s)),   s = jw, m(w) real

    m: real.
    """
    upwards = NYQUIST_FREQUENCIES > 0.0
    s = 1j * NYQUIST_FREQUENCIES[upwards]
    law = law[upwards]
    late = s**2 * np.exp(-(d + FORMATION_DELAYS.state_delay) * s)
    roots = (s**2 + law) / (late + law * np.exp(-(d + older) * s))
    k = np.flatnonzero(np.diff(np.signbit(roots.imag)))
    weight = roots.imag[k] / (roots.imag[k] - roots.imag[k + 1])
    critical = roots.real[k] + weight * (roots.real[k + 1] - roots.real[k])
    ordered: Vec = np.sort(m)
    after = np.searchsorted(ordered, critical)
    places = np.concatenate([[0, len(ordered) - 1], after, after - 1])
    chosen: Vec = ordered[np.unique(np.clip(places, 0, len(ordered) - 1))]
    return chosen


def _compute_attitude_response(chain: AccelerationChain) -> Complex:
    """Return G(jw) = A W / (jw + KR W), half a tick late.

    A is the response from the desired attitude to the rates.
    """
    s = 1j * NYQUIST_FREQUENCIES
    inner = chain.inner
    a = np.polyval(inner.attitude[0], s) / np.polyval(inner.attitude[1], s)
    w = np.polyval(inner.response[0], s) / np.polyval(inner.response[1], s)
    found: Complex = np.exp(-HOLD_DELAY * s) * a * w / (s + inner.kr * w)
    return found


def _compute_thrust_response(chain: AccelerationChain) -> Complex:
    """Return G(jw) = 1 / (lag jw + 1), half a tick late."""
    s = 1j * NYQUIST_FREQUENCIES
    found: Complex = np.exp(-HOLD_DELAY * s) / (chain.lag * s + 1.0)
    return found
