"""Find quiet channels: the order of the measurements, and how they are judged. No I/O here.

WiFi sends in bursts of seconds. Therefore the survey visits all channels many times, in a different
order in each pass: bursts then disturb all channels alike. Many short passes find rare interference
better than few long ones. The worst pass of a channel counts, not the mean, because a drone that
receives nothing for two seconds has landed by then.
"""

import random
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from crazychoir.radio.protocol.channels import pick_channels
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class SurveyPlan:
    """How often a survey visits each channel, and what it sends there."""

    retries: int = 3
    """Retransmissions that the Crazyradio does by itself, as cflib sets it."""
    passes: int = 20
    """Default number of passes. With the default number of packets they take two and a half
    minutes for 41 channels, at 1 to 2 ms a packet.
    """
    packets: int = 50
    """Default number of packets in a visit, for each kind."""


SURVEY_PLAN = SurveyPlan()


@dataclass(frozen=True)
class Sample:
    """Packets that were sent on one channel, one after another."""

    acknowledged: npt.NDArray[np.bool_]
    """(n,): whether each was acknowledged."""
    retries: npt.NDArray[np.int64]
    """(n,): retransmissions of each, at most those allowed."""
    round_trip: Vec
    """(n,) s."""
    rssi: Vec
    """(n,) dBm; NaN if the answer did not tell it."""


class Probe(Protocol):
    """A radio that can try a channel."""

    def measure(self, channel: int, packets: int, retries: int) -> Sample:
        """Send empty packets on a channel, and return how each was received.

        packets: number of packets
        retries: largest number of retransmissions of each packet
        """
        ...


class Visit(NamedTuple):
    """One measurement of one channel."""

    number: int
    """Number of the pass."""
    channel: int


@dataclass(frozen=True)
class ChannelResult:
    """The results of a channel."""

    channel: int
    """The channel."""
    passes: tuple[float, ...]
    """Share of acknowledged packets without retries, for each pass."""
    retries: tuple[int, ...]
    """Packets received at the 1st, 2nd, ... attempt.

    The last number counts packets that were not received at all.
    """
    round_trip: tuple[float, float] | None
    """s: median and 95 % of the received packets; None: none was received."""
    rssi: tuple[float, float] | None
    """dBm and dB: mean and standard deviation; None: none was received."""

    @property
    def worst(self) -> float:
        """The score: share of acknowledged packets in the worst pass."""
        return min(self.passes)

    @property
    def mean(self) -> float:
        """Share of acknowledged packets in all passes."""
        return sum(self.passes) / len(self.passes)


class Survey:
    """The order of visits, and their results.

    passes: number of passes
    packets: packets of each kind, without and with retries, in a visit
    seed: seed of the order
    """

    def __init__(
        self,
        channels: Sequence[int],
        passes: int = SURVEY_PLAN.passes,
        packets: int = SURVEY_PLAN.packets,
        seed: int = 0,
    ) -> None:
        self.channels = tuple(channels)
        self.passes = passes
        self.packets = packets
        self._order = random.Random(seed)  # noqa: S311 - the order of visits
        self._single: dict[int, list[Sample]] = defaultdict(list)
        self._retried: dict[int, list[Sample]] = defaultdict(list)

    def visits(self) -> Iterator[Visit]:
        """Yield the visits: each pass visits all channels, in a random order."""
        for number in range(self.passes):
            for channel in self._order.sample(self.channels, len(self.channels)):
                yield Visit(number, channel)

    def take(self, channel: int, single: Sample, retried: Sample) -> None:
        """Store the results of a visit.

        single: packets without retries
        retried: packets with retries
        """
        self._single[channel].append(single)
        self._retried[channel].append(retried)

    def measured(self) -> list[ChannelResult]:
        """Return the results of all visited channels, in increasing order."""
        return [
            self._of(channel) for channel in self.channels if channel in self._single
        ]

    def _of(self, channel: int) -> ChannelResult:
        single = self._single[channel]
        retried = self._retried[channel]
        came = np.concatenate([sample.acknowledged for sample in retried])
        tries = np.concatenate([sample.retries for sample in retried])[came]
        took = np.concatenate([sample.round_trip for sample in retried])[came]
        rssi = np.concatenate([sample.rssi for sample in (*single, *retried)])
        heard = rssi[~np.isnan(rssi)]
        counts = np.bincount(tries, minlength=SURVEY_PLAN.retries + 1)
        return ChannelResult(
            channel,
            tuple(float(np.mean(sample.acknowledged)) for sample in single),
            (*(int(n) for n in counts), int(np.sum(~came))),
            (float(np.median(took)), float(np.percentile(took, 95)))
            if len(took)
            else None,
            (float(np.mean(heard)), float(np.std(heard))) if len(heard) else None,
        )

    def pick(self, k: int, spacing: int) -> tuple[int, ...]:
        """Return k channels, at least `spacing` MHz apart, with the best scores.

        The score is the share of acknowledged packets in the worst pass, see `pick_channels`.
        """
        return pick_channels(
            {row.channel: (row.worst, row.mean) for row in self.measured()}, k, spacing
        )


def run_survey(
    found: Survey,
    probe: Probe,
    watch: Callable[[Survey, Visit], None] = lambda found, visit: None,
) -> None:
    """Do all measurements of a survey; `watch` is called after each visit."""
    for visit in found.visits():
        single = probe.measure(visit.channel, found.packets, 0)
        found.take(
            visit.channel,
            single,
            probe.measure(visit.channel, found.packets, SURVEY_PLAN.retries),
        )
        watch(found, visit)
