"""The modes of a formation behind the drones that fly it: how fast they decay, and how much delay they bear."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.control.gains import FORMATION, HOLD, Gains
from crazychoir.control.margin import (
    RATE_LAG,
    Inner,
    Loop,
    command_loop,
    delay_margin,
    guidance_loop,
    rate_loop,
    vertical_loop,
)
from crazychoir.platforms import Platform

TICK = 0.01  # s: an acceleration that is heard was commanded one tick before the state beside it
WORSE = 1.3  # times the lag of the rotors that was identified
LEVEL = 1e-6  # a mode with a smaller horizontal part moves in height only
FREQUENCIES = np.concatenate(
    [-np.geomspace(500.0, 1e-3, 3000), np.geomspace(1e-3, 500.0, 3000)]
)  # rad/s
OLDEST = 0.15  # s: longer nothing is asked about

Complex = npt.NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True)
class Chain:
    """What lies between the acceleration that a law wants and the drone that has it.

    gains: of the control behind the law;  lag: s, of the body rates, and of the thrust;  rates: W(s) of a rate loop on
    board, if the rates are no such lag.
    """

    gains: Gains = FORMATION
    lag: float = RATE_LAG
    rates: Loop | None = None

    @classmethod
    def of_motors(cls, gains: Gains, platform: Platform) -> "Chain":
        """Of a drone with rotors and a rate loop on board, slower than it was identified."""
        return cls(gains, WORSE * platform.rotor.lag, rate_loop(platform, 0, WORSE))

    @property
    def inner(self) -> Inner:
        """Of roll and pitch."""
        gains = self.gains
        return Inner(
            min(gains.kr[:2]),
            self.lag,
            lead=gains.lead,
            lead_cutoff=gains.lead_cutoff,
            rates=self.rates,
        )


def slowest_mode(eigenvalues: Sequence[complex], kp: float, kv: float) -> float:
    """Rate in 1/s at which the slowest mode decays: the smallest -Re s over s^2 + kv l s + kp l = 0."""
    return float(min(-np.roots([1.0, kv * e, kp * e]).real.max() for e in eigenvalues))


def slowest_normalised(eigenvalues: Sequence[complex], kp: float, kv: float) -> float:
    """Rate in 1/s at which the slowest mode of the normalised law decays.

    s^2 + kv s + kp = 0,   or, as what neighbours command goes from one to the next in a tick h,  e^(s h) = 1 - l
    """
    through = min(-math.log(max(abs(1.0 - e), 1e-12)) / TICK for e in eigenvalues)
    return min(slowest_mode([1.0], kp, kv), through)


def mode_margin(
    eigenvalues: Sequence[float],
    horizontal: Sequence[bool],
    kp: float,
    kv: float,
    chain: Chain = Chain(),
) -> float:
    """Smallest delay margin in s over the modes l, each with the gains kp l, kv l.

    A horizontal mode acts through the attitude; its delay may enter with the neighbours' data (guidance_loop) or with
    everything (command_loop). A mode in height alone acts through the thrust, of the same lag. Half a tick of 100 Hz
    is spent already; velocities come through a filter of 50 rad/s.
    """
    loops = []
    for e, tilts in zip(eigenvalues, horizontal, strict=True):
        if tilts:
            loops += [
                command_loop(kp * e, kv * e, chain.inner),
                guidance_loop(kp * e, kv * e, chain.inner),
            ]
        else:
            loops.append(vertical_loop(kp * e, kv * e, chain.lag))
    return max(min(map(delay_margin, loops), default=math.inf) - HOLD, 0.0)


def age_margin(
    eigenvalues: Sequence[complex],
    kp: float,
    kv: float,
    chain: Chain,
    moving: bool = False,
) -> float:
    """Largest s by which all that the normalised law hears may be older, in every mode l; 0 if it is unstable already.

        s^2 (1 - m e^(-(d + h) s)) + G(s) (kp + kv s F(s)) (1 - m e^(-(d + g) s)) = 0,   m = 1 - l

    d: that age;  h: one tick, for which a_j is older than p_j, v_j;  g: h too, where the law takes p_j, v_j from the
    tick of a_j, 0 where leaders move and it takes the newest;  G: of the attitude loop, or of the thrust;  F: of the
    velocity filter. By Nyquist: along the imaginary axis the phase of the left side over its first bracket turns twice
    by pi.
    """
    lags = (0.0, 0.005, 0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.1, OLDEST)
    m: Complex = np.array([[1.0 - e] for e in eigenvalues], dtype=np.complex128)
    responses = [_attitude_response(chain), _thrust_response(chain)]
    borne = 0.0
    for d in lags:
        if not all(
            _all_stable(m, kp, kv, g, d, 0.0 if moving else TICK) for g in responses
        ):
            return borne
        borne = d
    return borne


def _all_stable(
    m: Complex, kp: float, kv: float, response: Complex, d: float, older: float
) -> bool:
    s = 1j * FREQUENCIES
    law = response * (kp + kv * s * 50.0 / (s + 50.0))
    share = (1.0 - m * np.exp(-(d + older) * s)) / (1.0 - m * np.exp(-(d + TICK) * s))
    phase = np.unwrap(np.angle(s**2 + law * share), axis=1)
    turns = (phase[:, -1] - phase[:, 0]) / (2.0 * math.pi)
    return bool(np.all(np.round(turns) == 1))


def _attitude_response(chain: Chain) -> Complex:
    """G(jw) = A W / (jw + KR W), half a tick late, A: from the desired attitude to the rates."""
    s = 1j * FREQUENCIES
    inner = chain.inner
    a = np.polyval(inner.attitude[0], s) / np.polyval(inner.attitude[1], s)
    w = np.polyval(inner.response[0], s) / np.polyval(inner.response[1], s)
    found: Complex = np.exp(-HOLD * s) * a * w / (s + inner.kr * w)
    return found


def _thrust_response(chain: Chain) -> Complex:
    s = 1j * FREQUENCIES
    found: Complex = np.exp(-HOLD * s) / (chain.lag * s + 1.0)
    return found
