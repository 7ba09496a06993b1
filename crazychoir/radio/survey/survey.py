"""Which channels are quiet: what is measured on each, in which order, and how it is judged. No I/O in here.

WiFi comes in bursts of seconds. So the survey visits all channels again and again, each pass in another order: a burst
then hits all alike, not those that happened to have their turn. Many short passes see more than few long ones, as what
is used seldom has to be met. And what counts is the worst pass of a channel, not the mean: a drone that hears nothing
for two seconds has landed by then.
"""

import random
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from crazychoir.radio.protocol.channels import pick
from crazychoir.types import Vec

RETRIES = 3
"""How often the Crazyradio sends again by itself, as cflib flies it."""
PASSES, PACKETS = 20, 50
"""Unless somebody wants others: two and a half minutes for 41 channels, at a packet a ms or two."""


@dataclass(frozen=True)
class Sample:
    """Packets that were sent on one channel, one after the other.

    acknowledged: (n,);  retries: (n,) that each took, at most those allowed;  round_trip: (n,) s;
    rssi: (n,) dBm, NaN where the answer did not say.
    """

    acknowledged: npt.NDArray[np.bool_]
    retries: npt.NDArray[np.int64]
    round_trip: Vec
    rssi: Vec


class Probe(Protocol):
    """A radio that can try a channel."""

    def measure(self, channel: int, packets: int, retries: int) -> Sample:
        """Send so many packets that say nothing on a channel, each at most so often again."""
        ...


class Visit(NamedTuple):
    """One turn of one channel."""

    number: int
    """Of the pass."""
    channel: int


@dataclass(frozen=True)
class Measured:
    """What is known of a channel.

    passes: share of acknowledged packets without retries, a pass;  retries: packets that came through at the 1st, 2nd,
    ... attempt, and last those that did not at all;  round_trip: s, median and 95 %, of those that came through;
    rssi: dBm and dB, mean and standard deviation. None: nothing came back.
    """

    channel: int
    passes: tuple[float, ...]
    retries: tuple[int, ...]
    round_trip: tuple[float, float] | None
    rssi: tuple[float, float] | None

    @property
    def worst(self) -> float:
        """The score: share of acknowledged packets in the worst pass."""
        return min(self.passes)

    @property
    def mean(self) -> float:
        """Share of acknowledged packets of all passes."""
        return sum(self.passes) / len(self.passes)


class Survey:
    """The order of visits, and what they have brought.

    packets: of each kind, without and with retries, a visit;  seed: of the order.
    """

    def __init__(
        self,
        channels: Sequence[int],
        passes: int = PASSES,
        packets: int = PACKETS,
        seed: int = 0,
    ) -> None:
        self.channels = tuple(channels)
        self.passes = passes
        self.packets = packets
        self._order = random.Random(seed)  # noqa: S311 - of visits
        self._single: dict[int, list[Sample]] = defaultdict(list)
        self._retried: dict[int, list[Sample]] = defaultdict(list)

    def visits(self) -> Iterator[Visit]:
        """Each pass visits all channels, in an order of its own."""
        for number in range(self.passes):
            for channel in self._order.sample(self.channels, len(self.channels)):
                yield Visit(number, channel)

    def take(self, channel: int, single: Sample, retried: Sample) -> None:
        """What a visit brought, without and with retries."""
        self._single[channel].append(single)
        self._retried[channel].append(retried)

    def measured(self) -> list[Measured]:
        """Of the channels that were visited, increasing."""
        return [
            self._of(channel) for channel in self.channels if channel in self._single
        ]

    def _of(self, channel: int) -> Measured:
        single = self._single[channel]
        retried = self._retried[channel]
        came = np.concatenate([sample.acknowledged for sample in retried])
        tries = np.concatenate([sample.retries for sample in retried])[came]
        took = np.concatenate([sample.round_trip for sample in retried])[came]
        rssi = np.concatenate([sample.rssi for sample in (*single, *retried)])
        heard = rssi[~np.isnan(rssi)]
        counts = np.bincount(tries, minlength=RETRIES + 1)
        return Measured(
            channel,
            tuple(float(np.mean(sample.acknowledged)) for sample in single),
            (*(int(n) for n in counts), int(np.sum(~came))),
            (float(np.median(took)), float(np.percentile(took, 95)))
            if len(took)
            else None,
            (float(np.mean(heard)), float(np.std(heard))) if len(heard) else None,
        )

    def pick(self, k: int, spacing: int) -> tuple[int, ...]:
        """The k channels of the best worst pass that have the spacing; see channels.pick."""
        return pick(
            {row.channel: (row.worst, row.mean) for row in self.measured()}, k, spacing
        )


def survey(
    found: Survey,
    probe: Probe,
    watch: Callable[[Survey, Visit], None] = lambda found, visit: None,
) -> None:
    """Measure all that it wants to know; `watch` is called after each visit."""
    for visit in found.visits():
        single = probe.measure(visit.channel, found.packets, 0)
        found.take(
            visit.channel, single, probe.measure(visit.channel, found.packets, RETRIES)
        )
        watch(found, visit)
