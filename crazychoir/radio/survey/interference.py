"""Other transmitters around 2.4 GHz, for a simulated radio: WiFi, Bluetooth, jammers.

Each source gives its power in a receiver on a channel, and the times at which it sends: in bursts,
from dataclasses import dataclass
from a seed. Frequencies are MHz above 2400, the same as channels; powers are dBm at the drones.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from crazychoir.types import Vec

Active = npt.NDArray[np.bool_]
"""Flags (n,): whether a source sends."""


@dataclass(frozen=True, slots=True)
class InterferenceModel:
    """Widths and shares of time of the transmitters and the receiver."""

    receiver_width: float = 2.0
    """MHz: width of a receiver of 2 Mbit/s."""
    wifi_width: float = 18.0
    """MHz that hold the power of a WiFi channel."""
    beacon_share: float = 0.01
    """Share of the time that an unused network sends."""
    bluetooth_channels: int = 79
    """Bluetooth channels, each 1 MHz wide."""
    first_bluetooth_channel: int = 2
    """The first Bluetooth channel, MHz above 2400."""


INTERFERENCE_MODEL = InterferenceModel()


WIFI_MASK = ((0.0, 9.0, 11.0, 20.0, 30.0), (0.0, 0.0, -20.0, -28.0, -40.0))
"""MHz from the centre of a WiFi channel, and dB by which its power density is lower there.

Source: the transmit mask of IEEE 802.11 for OFDM in 20 MHz, which a transmitter may not exceed.
"""
RECEIVER_SELECTIVITY = ((0.0, 2.0, 4.0, 6.0, 12.0), (0.0, -7.0, -29.0, -35.0, -50.0))
"""MHz from the receiver's channel, and dB by which it weakens a narrow signal there.

The values are typical of such chips.
"""


class Transmitter(Protocol):
    """A transmitter of others."""

    def level(self, channel: int) -> float:
        """Return the power in a receiver on this channel, dBm, while the source sends."""
        ...

    def share(self, channel: int, in_use: bool) -> float:
        """Return the probability that a receiver on this channel is disturbed at some time.

        in_use: at a time at which the source is in use
        """
        ...

    def sends(self, channel: int, times: Vec, draw: np.random.Generator) -> Active:
        """Return whether a receiver on this channel is disturbed, at increasing times (n,) in s.

        The times must not be before those of an earlier call.
        """
        ...


class UsageTimes:
    """The times at which a source is in use: spans of exponential length, one after another.

    Ask for them in order of time.

    on: s: mean length of use
    off: s: mean pause; 0: always in use
    """

    def __init__(self, on: float, off: float, seed: int) -> None:
        self.on = on
        self.off = off
        self._draw = np.random.default_rng(seed)
        self._starts_on = bool(self._draw.random() < self.share)
        self._switches = np.zeros(0)

    @property
    def share(self) -> float:
        """Share of the time of use."""
        return self.on / (self.on + self.off)

    def at(self, times: Vec) -> Active:
        """Return (n,) whether the source is in use."""
        if self.off == 0.0:
            return np.ones(len(times), bool)
        while len(self._switches) == 0 or self._switches[-1] <= times[-1]:
            self._extend()
        switched = np.searchsorted(self._switches, times, side="right")
        return np.asarray((switched % 2 == 0) == self._starts_on)

    def _extend(self) -> None:
        """Append 64 switches; the number is even, so that each lot begins like the first."""
        means = np.tile(
            [self.on, self.off] if self._starts_on else [self.off, self.on], 32
        )
        end = self._switches[-1] if len(self._switches) else 0.0
        self._switches = np.append(
            self._switches, end + np.cumsum(self._draw.exponential(means))
        )


def draw_frames(
    times: Vec, share: float, length: float, draw: np.random.Generator
) -> Active:
    """Return (n,) whether a frame is on the air: frames and gaps have exponential lengths.

    times: (n,) s
    share: share of the time that frames take, below 1
    length: s: mean length of a frame
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
class WifiNetwork:
    """A WiFi network."""

    middle: float
    """MHz above 2400: centre of its channel."""
    power: float
    """dBm."""
    load: float
    """Share of the time that its frames take while it is in use."""
    frame: float
    """s: mean length of a frame."""
    uses: UsageTimes
    """Times of use; at other times it sends only beacons."""

    def level(self, channel: int) -> float:
        """Return the part of its power that falls into the receiver, dBm."""
        below = float(np.interp(abs(channel - self.middle), *WIFI_MASK))
        return (
            self.power
            + 10.0
            * float(
                np.log10(
                    INTERFERENCE_MODEL.receiver_width / INTERFERENCE_MODEL.wifi_width
                )
            )
            + below
        )

    def share(self, channel: int, in_use: bool) -> float:
        """Return the share of frames while it is in use, and of beacons otherwise."""
        used = 1.0 if in_use else self.uses.share
        return used * self.load + (1.0 - used) * INTERFERENCE_MODEL.beacon_share

    def sends(self, channel: int, times: Vec, draw: np.random.Generator) -> Active:
        """Return the times of frames and beacons."""
        beacons = draw.random(len(times)) < INTERFERENCE_MODEL.beacon_share
        used = self.uses.at(times)
        return (
            np.where(used, draw_frames(times, self.load, self.frame, draw), beacons)
            if used.any()
            else beacons
        )


@dataclass(frozen=True)
class Bluetooth:
    """A Bluetooth device; its packets hop over 79 channels."""

    power: float
    """dBm."""
    load: float
    """Share of the time that it sends."""

    def level(self, channel: int) -> float:
        """Return its whole power, dBm: it is as narrow as the receiver."""
        return self.power

    def share(self, channel: int, in_use: bool) -> float:
        """Return its share of the time, times the share of hops that the receiver hears."""
        heard = sum(
            abs(INTERFERENCE_MODEL.first_bluetooth_channel + hop - channel)
            <= INTERFERENCE_MODEL.receiver_width / 2
            for hop in range(INTERFERENCE_MODEL.bluetooth_channels)
        )
        return self.load * heard / INTERFERENCE_MODEL.bluetooth_channels

    def sends(self, channel: int, times: Vec, draw: np.random.Generator) -> Active:
        """Return the times at which it disturbs; each hop is independent of the one before."""
        return draw.random(len(times)) < self.share(channel, True)


@dataclass(frozen=True)
class Jammer:
    """A narrow signal without gaps, such as a camera or an alarm."""

    middle: float
    """MHz above 2400."""
    power: float
    """dBm."""
    uses: UsageTimes
    """Times of use."""

    def level(self, channel: int) -> float:
        """Return the power that the receiver's filter passes, dBm."""
        return self.power + float(
            np.interp(abs(channel - self.middle), *RECEIVER_SELECTIVITY)
        )

    def share(self, channel: int, in_use: bool) -> float:
        """Return the share of the time: all of it while the jammer is in use."""
        return 1.0 if in_use else self.uses.share

    def sends(self, channel: int, times: Vec, draw: np.random.Generator) -> Active:
        """Return the times at which it is in use."""
        return self.uses.at(times)
