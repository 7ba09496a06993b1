"""A simulated radio and drone in a noisy room, with a time of its own, to try a survey.

A packet is received or not by the signal, the noise and the interference at the time of each
attempt:

    SINR = S / (N + sum of the active sources)
    P(bit wrong) = exp(-SINR / 2) / 2,   P(through) = (1 - P(bit wrong))^n

n: bits of a packet and its answer (`RECEIVER_MODEL.packet_bits`).

This is the error rate of frequency-shift keying without a phase reference.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from crazychoir.radio.protocol.channels import WIFI_CENTRES
from crazychoir.radio.survey.interference import (
    Bluetooth,
    Jammer,
    Transmitter,
    UsageTimes,
    WifiNetwork,
)
from crazychoir.radio.survey.survey import Sample
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class ReceiverModel:
    """The noise of a receiver and the length of its packets."""

    noise: float = -93.0
    """dBm in 2 MHz. One bit in a thousand is then wrong at -82 dBm, the specification of nRF24L01+
    receivers at 2 Mbit/s.
    """
    negligible: float = -108.0
    """dBm: 15 dB below the noise."""
    packet_bits: int = 178
    """Bits of a packet of one byte and its answer of three. They include preamble, address,
    control field and checksum of both.
    """


RECEIVER_MODEL = ReceiverModel()


@dataclass(frozen=True, slots=True)
class RadioTiming:
    """Times of the exchanges of a dongle."""

    exchange_time: float = 0.0008
    """s that an exchange takes at least; about what users of the dongle report."""
    exchange_jitter: float = 0.0001
    """s: mean of the additional time of an exchange."""
    retry_period: float = 0.0005
    """s from one attempt to the next."""
    channel_change: float = 0.02
    """s to take the drone to another channel."""


RADIO_TIMING = RadioTiming()


@dataclass(frozen=True, slots=True)
class FadingModel:
    """The paths of the signal, and its changes in time."""

    flicker: float = 1.0
    """dB: standard deviation of the signal from packet to packet."""
    reflections: int = 6
    """Reflections of the signal."""
    delay_spread: float = 50e-9
    """s by which the last reflection is late."""
    direct_ratio: float = 4.0
    """Power of the direct signal in relation to the power of all reflections: K."""


FADING_MODEL = FadingModel()


HERMITE_NODES, _RAW_WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
"""Nodes at which means over a normal distribution are computed."""
HERMITE_WEIGHTS = _RAW_WEIGHTS / _RAW_WEIGHTS.sum()
"""Weights of the nodes; their sum is 1."""


def reception_probability(sinr: Mat) -> Mat:
    """Return the probability that a packet is received; sinr: a ratio of powers."""
    return np.asarray((1.0 - 0.5 * np.exp(-0.5 * sinr)) ** RECEIVER_MODEL.packet_bits)


@dataclass(frozen=True)
class RadioRoom:
    """The signal and the interference on the air."""

    signal: dict[int, float]
    """{channel: dBm} of the link itself, the sum of all its paths."""
    sources: tuple[Transmitter, ...]
    """Other transmitters."""

    def heard(self, channel: int) -> list[tuple[Transmitter, float]]:
        """Return the sources that a receiver on this channel hears, with their power in mW."""
        levels = [(source, source.level(channel)) for source in self.sources]
        return [
            (source, _to_milliwatts(level))
            for source, level in levels
            if level > RECEIVER_MODEL.negligible
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
        noise = _to_milliwatts(RECEIVER_MODEL.noise) + sent @ np.array(
            [power for _, power in heard]
        )
        through = (
            reception_probability(
                _array_to_milliwatts(
                    self.signal[channel] + FADING_MODEL.flicker * HERMITE_NODES
                )
                / noise[:, None]
            )
            @ HERMITE_WEIGHTS
        )
        return float(chances @ through)


class SimulatedRadio:
    """The simulated probe: its time passes as packets are sent.

    seed: seed of all draws
    """

    def __init__(self, room: RadioRoom, seed: int) -> None:
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
            self.now = self.now + RADIO_TIMING.channel_change
        period = (
            RADIO_TIMING.exchange_time
            + RADIO_TIMING.exchange_jitter
            + retries * RADIO_TIMING.retry_period
        )
        starts = self.now + period * np.arange(packets)
        self.now += period * packets
        signal = _array_to_milliwatts(
            self.room.signal[channel]
            + FADING_MODEL.flicker * self._draw.standard_normal(packets)
        )[:, None]
        times = starts[:, None] + RADIO_TIMING.retry_period * np.arange(retries + 1)
        noise = self._noise(channel, times)
        came = self._draw.random(times.shape) < reception_probability(signal / noise)
        acknowledged = np.asarray(came.any(axis=1))
        used = np.where(acknowledged, came.argmax(axis=1), retries)
        took = (
            RADIO_TIMING.exchange_time
            + self._draw.exponential(RADIO_TIMING.exchange_jitter, packets)
            + RADIO_TIMING.retry_period * used
        )
        received = np.take_along_axis(signal + noise, used[:, None], axis=1)[:, 0]
        rssi = np.where(acknowledged, np.round(10.0 * np.log10(received)), np.nan)
        return Sample(acknowledged, used, took, rssi)

    def _noise(self, channel: int, times: Mat) -> Mat:
        """Return the noise in mW at each attempt."""
        noise = np.full(times.size, _to_milliwatts(RECEIVER_MODEL.noise))
        for source, power in self._heard[channel]:
            noise += source.sends(channel, times.ravel(), self._draw) * power
        return noise.reshape(times.shape)


def random_room(seed: int, channels: Sequence[int]) -> RadioRoom:
    """Return a room with a link of some metres.

    It has one to seven networks, up to two Bluetooth devices and up to two jammers.
    """
    draw = np.random.default_rng(seed)
    networks = [_random_network(draw) for _ in range(draw.integers(1, 8))]
    phones = [
        Bluetooth(draw.uniform(-75.0, -45.0), draw.uniform(0.1, 0.5))
        for _ in range(draw.integers(0, 3))
    ]
    jammers = [_random_jammer(draw) for _ in range(draw.integers(0, 3))]
    strength = draw.uniform(-65.0, -45.0)
    gains = _draw_gains(np.array(channels, float), draw)
    signal = {
        c: float(strength + gain) for c, gain in zip(channels, gains, strict=True)
    }
    return RadioRoom(signal, (*networks, *phones, *jammers))


def _random_network(draw: np.random.Generator) -> WifiNetwork:
    """Return a WiFi network.

    It is on one of the three channels without overlap or, two times in five, on any channel from 1
    to 13.
    """
    number = (
        draw.choice(list(WIFI_CENTRES)) if draw.random() < 0.6 else draw.integers(1, 14)
    )
    return WifiNetwork(
        middle=7.0 + 5.0 * float(number),
        power=draw.uniform(-75.0, -40.0),
        load=draw.uniform(0.1, 0.8),
        frame=draw.uniform(0.0003, 0.0025),
        uses=_random_usage(draw),
    )


def _random_jammer(draw: np.random.Generator) -> Jammer:
    return Jammer(
        draw.uniform(0.0, 83.0), draw.uniform(-75.0, -45.0), _random_usage(draw)
    )


def _random_usage(draw: np.random.Generator) -> UsageTimes:
    return UsageTimes(
        draw.uniform(2.0, 20.0), draw.uniform(1.0, 60.0), int(draw.integers(2**32))
    )


def _draw_gains(channels: Vec, draw: np.random.Generator) -> Vec:
    """Return the gain of each channel in dB.

    The direct path and its reflections add up or cancel, by frequency.

        h(f) = sqrt(K / (K + 1)) + sqrt(1 / (K + 1)) sum_m a_m exp(-2 pi i f t_m)
    """
    amplitudes = (
        draw.standard_normal(FADING_MODEL.reflections)
        + 1j * draw.standard_normal(FADING_MODEL.reflections)
    ) / np.sqrt(2.0 * FADING_MODEL.reflections)
    delays = draw.uniform(0.0, FADING_MODEL.delay_spread, FADING_MODEL.reflections)
    turns = np.exp(-2j * np.pi * np.outer((2400.0 + channels) * 1e6, delays))
    h = (
        np.sqrt(FADING_MODEL.direct_ratio / (FADING_MODEL.direct_ratio + 1.0))
        + np.sqrt(1.0 / (FADING_MODEL.direct_ratio + 1.0)) * turns @ amplitudes
    )
    return np.asarray(20.0 * np.log10(np.abs(h)))


def _to_milliwatts(dbm: float) -> float:
    """Return mW."""
    return float(10.0 ** (dbm / 10.0))


def _array_to_milliwatts(dbm: Vec) -> Vec:
    return np.asarray(10.0 ** (dbm / 10.0))
