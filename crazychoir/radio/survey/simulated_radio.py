"""A radio and a drone in a noisy room, simulated in a time of its own: for trying a survey, and for its tests.

Whether a packet comes through follows from signal, noise and interference at the time of each attempt:

    SINR = S / (N + sum of those who send),   P(bit wrong) = exp(-SINR / 2) / 2,   P(through) = (1 - P(bit wrong))^BITS

the law of frequency keying without a phase reference.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from crazychoir.radio.protocol.channels import WIFI
from crazychoir.radio.survey.interference import (
    Bluetooth,
    Jammer,
    Network,
    Source,
    Uses,
)
from crazychoir.radio.survey.survey import Sample
from crazychoir.types import Mat, Vec

NOISE = -93.0
"""dBm in 2 MHz: one bit in a thousand is wrong at -82 dBm, as nRF24L01+ receivers are specified at 2 Mbit/s."""
NEGLIGIBLE = -108.0
"""dBm: 15 dB below the noise."""
BITS = 178
"""A packet of one byte and its answer of three: preamble, address, control field and checksum of both."""
USB, USB_JITTER = 0.0008, 0.0001
"""s that an exchange takes at least, and the mean of what comes on top; about what users of the dongle report."""
ATTEMPT = 0.0005
"""s from one attempt to the next."""
HOP = 0.02
"""s to take the drone to another channel."""
FLICKER = 1.0
"""dB, standard deviation from packet to packet."""
ECHOES, SPREAD, DIRECT = 6, 50e-9, 4.0
"""Reflections of the signal; s by which the last is late; how much stronger than all of them what comes directly is."""
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
WEIGHTS = WEIGHTS / WEIGHTS.sum()
"""For means over a normal distribution."""


def success(sinr: Mat) -> Mat:
    """Probability that a packet comes through; sinr: a ratio of powers."""
    return np.asarray((1.0 - 0.5 * np.exp(-0.5 * sinr)) ** BITS)


@dataclass(frozen=True)
class Room:
    """What is on the air.

    signal: {channel: dBm} of the link itself, as its reflections add up;  sources: of the others.
    """

    signal: dict[int, float]
    sources: tuple[Source, ...]

    def heard(self, channel: int) -> list[tuple[Source, float]]:
        """Those that a receiver on this channel hears at all, each with its power there, in mW."""
        levels = [(source, source.level(channel)) for source in self.sources]
        return [
            (source, _power(level)) for source, level in levels if level > NEGLIGIBLE
        ]

    def expected(self, channel: int, in_use: bool = False) -> float:
        """True share of acknowledged packets, without retries; in the long run, or while everything is in use.

        The sum over all sets of sources that may send at a time, each with its probability, of what comes through,
        over all that the signal flickers.
        """
        heard = self.heard(channel)
        sent = np.array(list(product((False, True), repeat=len(heard))), bool).reshape(
            2 ** len(heard), len(heard)
        )
        shares = np.array([source.share(channel, in_use) for source, _ in heard])
        chances = np.where(sent, shares, 1.0 - shares).prod(axis=1)
        noise = _power(NOISE) + sent @ np.array([power for _, power in heard])
        through = (
            success(_powers(self.signal[channel] + FLICKER * NODES) / noise[:, None])
            @ WEIGHTS
        )
        return float(chances @ through)


class SimulatedRadio:
    """The probe: time passes as packets are sent."""

    def __init__(self, room: Room, seed: int) -> None:
        self.room = room
        self.now = 0.0
        self.channel = -1
        self._heard = {c: room.heard(c) for c in room.signal}
        self._draw = np.random.default_rng(seed)

    def measure(self, channel: int, packets: int, retries: int) -> Sample:
        """As Probe; each packet has time for all its attempts, whether it needs them or not."""
        if channel != self.channel:
            self.channel = channel
            self.now = self.now + HOP
        period = USB + USB_JITTER + retries * ATTEMPT
        starts = self.now + period * np.arange(packets)
        self.now += period * packets
        signal = _powers(
            self.room.signal[channel] + FLICKER * self._draw.standard_normal(packets)
        )[:, None]
        times = starts[:, None] + ATTEMPT * np.arange(retries + 1)
        noise = self._noise(channel, times)
        came = self._draw.random(times.shape) < success(signal / noise)
        acknowledged = np.asarray(came.any(axis=1))
        used = np.where(acknowledged, came.argmax(axis=1), retries)
        took = USB + self._draw.exponential(USB_JITTER, packets) + ATTEMPT * used
        received = np.take_along_axis(signal + noise, used[:, None], axis=1)[:, 0]
        rssi = np.where(acknowledged, np.round(10.0 * np.log10(received)), np.nan)
        return Sample(acknowledged, used, took, rssi)

    def _noise(self, channel: int, times: Mat) -> Mat:
        """mW at each attempt."""
        noise = np.full(times.size, _power(NOISE))
        for source, power in self._heard[channel]:
            noise += source.sends(channel, times.ravel(), self._draw) * power
        return noise.reshape(times.shape)


def random_room(seed: int, channels: Sequence[int]) -> Room:
    """A link of some metres among one to seven networks, up to two Bluetooth devices and two jammers."""
    draw = np.random.default_rng(seed)
    networks = [_network(draw) for _ in range(draw.integers(1, 8))]
    phones = [
        Bluetooth(draw.uniform(-75.0, -45.0), draw.uniform(0.1, 0.5))
        for _ in range(draw.integers(0, 3))
    ]
    jammers = [_jammer(draw) for _ in range(draw.integers(0, 3))]
    strength = draw.uniform(-65.0, -45.0)
    gains = _gains(np.array(channels, float), draw)
    signal = {
        c: float(strength + gain) for c, gain in zip(channels, gains, strict=True)
    }
    return Room(signal, (*networks, *phones, *jammers))


def _network(draw: np.random.Generator) -> Network:
    """On one of the three channels that do not overlap, or, two times in five, anywhere from 1 to 13."""
    number = draw.choice(list(WIFI)) if draw.random() < 0.6 else draw.integers(1, 14)
    return Network(
        middle=7.0 + 5.0 * float(number),
        power=draw.uniform(-75.0, -40.0),
        load=draw.uniform(0.1, 0.8),
        frame=draw.uniform(0.0003, 0.0025),
        uses=_uses(draw),
    )


def _jammer(draw: np.random.Generator) -> Jammer:
    return Jammer(draw.uniform(0.0, 83.0), draw.uniform(-75.0, -45.0), _uses(draw))


def _uses(draw: np.random.Generator) -> Uses:
    return Uses(
        draw.uniform(2.0, 20.0), draw.uniform(1.0, 60.0), int(draw.integers(2**32))
    )


def _gains(channels: Vec, draw: np.random.Generator) -> Vec:
    """dB by channel: the direct way and its reflections add up or cancel, by frequency.

    h(f) = sqrt(K / (K + 1)) + sqrt(1 / (K + 1)) sum_m a_m exp(-2 pi i f t_m)
    """
    amplitudes = (
        draw.standard_normal(ECHOES) + 1j * draw.standard_normal(ECHOES)
    ) / np.sqrt(2.0 * ECHOES)
    delays = draw.uniform(0.0, SPREAD, ECHOES)
    turns = np.exp(-2j * np.pi * np.outer((2400.0 + channels) * 1e6, delays))
    h = (
        np.sqrt(DIRECT / (DIRECT + 1.0))
        + np.sqrt(1.0 / (DIRECT + 1.0)) * turns @ amplitudes
    )
    return np.asarray(20.0 * np.log10(np.abs(h)))


def _power(dbm: float) -> float:
    """mW."""
    return float(10.0 ** (dbm / 10.0))


def _powers(dbm: Vec) -> Vec:
    return np.asarray(10.0 ** (dbm / 10.0))
