"""The poses of all drones of a dongle, told in packets for several drones.

No drone acknowledges these packets, and none is sent again: the next one has newer poses. A drone that
misses them flies by its own sensors; what it does then is in the safety table.
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from crazychoir.config.uris import RADIO_SCHEME
from crazychoir.mocap.view import RateLimit
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.link.broadcast import DongleBroadcast
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.protocol.packed_poses import NumberedPose, pack_poses
from crazychoir.runtime.clock import NS_PER_SECOND, AlarmPriority, Clock


@dataclass(frozen=True, slots=True)
class BroadcastLimits:
    """When the poses of a frame are sent, and how their ages are kept."""

    gathering: float = 0.005
    """s from the first pose of a frame until all that came are sent."""
    oldest_sent: float = 0.1
    """s: an older pose is not sent."""
    kept_ages: int = 1000
    """Number of poses for the statistics of ages."""
    age_quantile: float = 0.95
    """Share of the poses that are not older than the age that is reported."""


BROADCAST_LIMITS = BroadcastLimits()


@dataclass(frozen=True, slots=True)
class ToldPose:
    """A pose that waits to be sent."""

    row: NumberedPose
    """The pose, with the number of its drone."""
    made: float
    """s: when the cameras saw it."""
    connection: Connection
    """Connection to the drone."""
    setup: DroneSetup
    """The drone."""


class PoseBroadcast:
    """Sends the newest poses of the drones of one dongle at some rate.

    rate: Hz
    """

    def __init__(self, clock: Clock, rate: float) -> None:
        self._clock = clock
        self._limit = RateLimit(rate)
        self._waiting: dict[int, ToldPose] = {}
        self._is_due = False
        self._radios: dict[tuple[int, str], DongleBroadcast] = {}
        self._ages: deque[float] = deque(maxlen=BROADCAST_LIMITS.kept_ages)
        self.sent = 0
        """Number of poses that were sent."""

    def tell(self, told: ToldPose) -> None:
        """Send a pose with the next packets, in place of an older one of the same drone.

        Raises CodecError if it does not fit into a packet.
        """
        told.row.require_fit()
        self._waiting[told.setup.drone] = told
        now = self._clock.now()
        if not self._is_due and self._limit.passes(now):
            self._is_due = True
            self._clock.call_at(
                self._clock.now_ns()
                + round(BROADCAST_LIMITS.gathering * NS_PER_SECOND),
                self._send,
                priority=AlarmPriority.MESSAGE,
                drone=told.setup.drone,
            )

    def _send(self) -> None:
        """Send all poses that wait, in a broadcast for each channel and data rate."""
        self._is_due = False
        oldest = self._clock.now() - BROADCAST_LIMITS.oldest_sent
        groups: dict[tuple[int, str], list[ToldPose]] = {}
        for told in self._waiting.values():
            if told.made >= oldest:
                groups.setdefault(told.setup.radio_settings, []).append(told)
        self._waiting = {}
        for settings, group in groups.items():
            self._send_group(settings, group)

    def _send_group(self, settings: tuple[int, str], group: list[ToldPose]) -> None:
        packets = pack_poses(told.row for told in group)
        times = [told.made for told in group]
        uri = group[0].setup.row.uri
        if not uri.startswith(RADIO_SCHEME):
            # By UDP each drone is sent the packets; its dongle, if it has one, sends them once.
            for told in group:
                told.connection.send_at_once(packets)
            self._note_sent(times)
            return
        radio = self._radios.get(settings)
        if radio is None:
            radio = self._radios[settings] = DongleBroadcast(uri, self._note_sent)
        radio.newest(packets, times)

    def _note_sent(self, times: Iterable[float]) -> None:
        """Note that poses have left; called from any thread.

        times: s: when the cameras saw them
        """
        now = self._clock.now()
        for made in times:
            self._ages.append(now - made)
            self.sent += 1

    @property
    def age(self) -> float:
        """Age in s that 95 of 100 poses did not exceed when they left; NaN before the first."""
        ages = sorted(self._ages)
        if not ages:
            return math.nan
        return ages[math.ceil(BROADCAST_LIMITS.age_quantile * len(ages)) - 1]

    def end(self) -> None:
        """End the threads."""
        for radio in self._radios.values():
            radio.end()
