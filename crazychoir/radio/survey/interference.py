"""Who else is on the air around 2.4 GHz, for a radio that is simulated: WiFi, Bluetooth, jammers.

Each source says how strong it is in a receiver on a channel, and when it sends: in bursts, from a seed.
Frequencies in MHz above 2400, as channels; powers in dBm where the drones are.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from crazychoir.types import Vec

Active = npt.NDArray[np.bool_]
WIDTH = 2.0
"""MHz of a receiver of 2 Mbit/s."""
SILENT = -200.0
"""dBm that nobody hears."""
MASK = ((0.0, 9.0, 11.0, 20.0, 30.0), (0.0, 0.0, -20.0, -28.0, -40.0))
"""MHz from the middle of a WiFi channel, and dB that its density is below that in the middle.
Source: the transmit mask of IEEE 802.11 for OFDM in 20 MHz, which a transmitter may not exceed."""
WIFI_FLAT = 18.0
"""MHz that hold the power of a WiFi channel."""
SELECTIVITY = ((0.0, 2.0, 4.0, 6.0, 12.0), (0.0, -7.0, -29.0, -35.0, -50.0))
"""MHz from the receiver's channel, and dB by which it weakens a narrow signal there: about as chips of this kind do."""
BEACONS = 0.01
"""Share of the time that a network sends while nobody uses it."""
HOPS, FIRST_HOP = 79, 2
"""Bluetooth's channels, each 1 MHz, from 2402 MHz on."""


class Source(Protocol):
    """Somebody else's transmitter."""

    def level(self, channel: int) -> float:
        """dBm in a receiver on this channel, while it sends."""
        ...

    def share(self, channel: int, in_use: bool) -> float:
        """Probability that a receiver on this channel has it at some time; in_use: at one when somebody uses it."""
        ...

    def sends(self, channel: int, times: Vec, draw: np.random.Generator) -> Active:
        """Whether a receiver on this channel has it, at increasing times (n,) s, never before those asked last."""
        ...


class Uses:
    """When something is in use: spans of exponential length, one after the other; asked in the order of time.

    on, off: s, mean length;  never off: `off` is 0.
    """

    def __init__(self, on: float, off: float, seed: int) -> None:
        self.on = on
        self.off = off
        self._draw = np.random.default_rng(seed)
        self._starts_on = bool(self._draw.random() < self.share)
        self._switches = np.zeros(0)

    @property
    def share(self) -> float:
        """Of the time that it is in use."""
        return self.on / (self.on + self.off)

    def at(self, times: Vec) -> Active:
        """(n,) whether it is in use."""
        if self.off == 0.0:
            return np.ones(len(times), bool)
        while len(self._switches) == 0 or self._switches[-1] <= times[-1]:
            self._extend()
        switched = np.searchsorted(self._switches, times, side="right")
        return np.asarray((switched % 2 == 0) == self._starts_on)

    def _extend(self) -> None:
        """64 switches more; an even number, so that each lot begins as the first."""
        means = np.tile(
            [self.on, self.off] if self._starts_on else [self.off, self.on], 32
        )
        end = self._switches[-1] if len(self._switches) else 0.0
        self._switches = np.append(
            self._switches, end + np.cumsum(self._draw.exponential(means))
        )


def frames(
    times: Vec, share: float, length: float, draw: np.random.Generator
) -> Active:
    """(n,) whether a frame is on the air: frames and gaps of exponential length, as long as the times reach.

    share: of the time that frames take, below 1;  length: s of a frame, on average.
    """
    gap = length * (1.0 - share) / share
    on = bool(draw.random() < share)
    span = times[-1] - times[0]
    count = 16
    means = [length, gap] if on else [gap, length]
    switches = np.zeros(0)
    while len(switches) == 0 or switches[-1] < span:
        lot = np.cumsum(draw.exponential(np.tile(means, count)))
        switches = np.append(switches, lot + (switches[-1] if len(switches) else 0.0))
        count = 2 * count + int(span / (length + gap))
    switched = np.searchsorted(switches, times - times[0], side="right")
    return np.asarray((switched % 2 == 0) == on)


@dataclass(frozen=True)
class Network:
    """A WiFi network.

    middle: MHz above 2400;  power: dBm;  load: share of the time that its frames take while it is used;
    frame: s, mean;  uses: when it is used; else it sends beacons alone.
    """

    middle: float
    power: float
    load: float
    frame: float
    uses: Uses

    def level(self, channel: int) -> float:
        """The part of its power that falls into the receiver."""
        below = float(np.interp(abs(channel - self.middle), *MASK))
        return self.power + 10.0 * float(np.log10(WIDTH / WIFI_FLAT)) + below

    def share(self, channel: int, in_use: bool) -> float:
        """Frames while it is used, beacons else."""
        used = 1.0 if in_use else self.uses.share
        return used * self.load + (1.0 - used) * BEACONS

    def sends(self, channel: int, times: Vec, draw: np.random.Generator) -> Active:
        """Frames and beacons."""
        beacons = draw.random(len(times)) < BEACONS
        used = self.uses.at(times)
        return (
            np.where(used, frames(times, self.load, self.frame, draw), beacons)
            if used.any()
            else beacons
        )


@dataclass(frozen=True)
class Bluetooth:
    """Somebody whose packets hop over 79 channels. power: dBm;  load: share of the time that it sends."""

    power: float
    load: float

    def level(self, channel: int) -> float:
        """All of it: it is as narrow as the receiver."""
        return self.power

    def share(self, channel: int, in_use: bool) -> float:
        """Of its hops those that the receiver hears count."""
        heard = sum(abs(FIRST_HOP + hop - channel) <= WIDTH / 2 for hop in range(HOPS))
        return self.load * heard / HOPS

    def sends(self, channel: int, times: Vec, draw: np.random.Generator) -> Active:
        """Each hop is another: what was there before says nothing."""
        return draw.random(len(times)) < self.share(channel, True)


@dataclass(frozen=True)
class Jammer:
    """A narrow signal without gaps, such as a camera's or an alarm's. middle: MHz above 2400;  power: dBm."""

    middle: float
    power: float
    uses: Uses

    def level(self, channel: int) -> float:
        """What the receiver's filter leaves of it."""
        return self.power + float(np.interp(abs(channel - self.middle), *SELECTIVITY))

    def share(self, channel: int, in_use: bool) -> float:
        """All the time while it is used."""
        return 1.0 if in_use else self.uses.share

    def sends(self, channel: int, times: Vec, draw: np.random.Generator) -> Active:
        """While it is used."""
        return self.uses.at(times)
