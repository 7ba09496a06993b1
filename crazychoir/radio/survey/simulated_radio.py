"""A simulated radio and drone in a noisy room, with a time of its own, to try a survey.

A packet is received or not by the signal, the noise and the interference at the time of each
attempt:

    SINR = S / (N + sum of the active sources)
    P(bit wrong) = exp(-SINR / 2) / 2,   P(through) = (1 - P(bit wrong))^BITS

This is the error rate of frequency-shift keying without a phase reference.
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
"""dBm in 2 MHz.

One bit in a thousand is then wrong at -82 dBm, the specification of nRF24L01+ receivers at 2
Mbit/s.
"""
NEGLIGIBLE = -108.0
"""dBm: 15 dB below the noise."""
BITS = 178
"""Bits of a packet of one byte and its answer of three.

They include preamble, address, control field and checksum of both.
"""
USB = 0.0008
"""Seconds that an exchange takes at least; about what users of the dongle report."""
USB_JITTER = 0.0001
"""Seconds: mean of the additional time of an exchange."""
ATTEMPT = 0.0005
"""Seconds from one attempt to the next."""
HOP = 0.02
"""Seconds to take the drone to another channel."""
FLICKER = 1.0
"""dB: standard deviation of the signal from packet to packet."""
ECHOES = 6
"""Reflections of the signal."""
SPREAD = 50e-9
"""Seconds by which the last reflection is late."""
DIRECT = 4.0
"""Power of the direct signal in relation to the power of all reflections."""
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
WEIGHTS = WEIGHTS / WEIGHTS.sum()
"""NODES and WEIGHTS compute means over a normal distribution."""


def success(sinr: Mat) -> Mat:
    """Return the probability that a packet is received; sinr: a ratio of powers."""
    return np.asarray((1.0 - 0.5 * np.exp(-0.5 * sinr)) ** BITS)


@dataclass(frozen=True)
class Room:
    """The signal and the interference on the air."""

    signal: dict[int, float]
    """{channel: dBm} of the link itself, the sum of all its paths."""
    sources: tuple[Source, ...]
    """Other transmitters."""

    def heard(self, channel: int) -> list[tuple[Source, float]]:
        """Return the sources that a receiver on this channel hears, with their power in mW."""
        levels = [(source, source.level(channel)) for source in self.sources]
        return [
            (source, _power(level)) for source, level in levels if level > NEGLIGIBLE
        ]

    def expected(self, channel: int, in_use: bool = False) -> float:
        """Return the true share of acknowledged packets without retries.

        In the long run, or while all sources are in use. It is the sum, over all sets of sources
        that may send at a time, of the probability of the set times the probability that a packet
        is received, averaged over the flicker of the signal.
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
    """The simulated probe: its time passes as packets are sent.

    seed: seed of all draws
    """

    def __init__(self, room: Room, seed: int) -> None:
        self.room = room
        self.now = 0.0
        """s."""
        self.channel = -1
        self._heard = {c: room.heard(c) for c in room.signal}
        self._draw = np.random.default_rng(seed)

    def measure(self, channel: int, packets: int, retries: int) -> Sample:
        """Measure a channel, see Probe.

        Each packet takes the time of all its attempts, used or not.
        """
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
        """Return the noise in mW at each attempt."""
        noise = np.full(times.size, _power(NOISE))
        for source, power in self._heard[channel]:
            noise += source.sends(channel, times.ravel(), self._draw) * power
        return noise.reshape(times.shape)


def random_room(seed: int, channels: Sequence[int]) -> Room:
    """Return a room with a link of some metres.

    It has one to seven networks, up to two Bluetooth devices and up to two jammers.
    """
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
    """Return a WiFi network.

    It is on one of the three channels without overlap or, two times in five, on any channel from 1
    to 13.
    """
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
    """Return the gain of each channel in dB.

    The direct path and its reflections add up or cancel, by frequency.

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
    """Return mW."""
    return float(10.0 ** (dbm / 10.0))


def _powers(dbm: Vec) -> Vec:
    return np.asarray(10.0 ** (dbm / 10.0))
