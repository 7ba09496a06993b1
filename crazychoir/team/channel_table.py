"""The channels of one drone, across the epochs of its team."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from crazychoir.errors import ConfigError, RosterChanged
from crazychoir.team.channel import Channel, RoundCounters, fail_waiter, wake_if
from crazychoir.team.epochs import AnyGraph, Epochs
from crazychoir.team.graph import Graph
from crazychoir.team.message_kind import EPOCH_SHIFT
from crazychoir.team.messages import Roster

FAILURE_CHANNEL = "failed"
"""Channel on which an agent says that it stops on all channels."""


@dataclass(frozen=True, slots=True)
class ChannelLimits:
    """How many channels a drone may have."""

    most_open: int = 256
    """Most channels that are open at once."""


CHANNEL_LIMITS = ChannelLimits()


class Membership(Protocol):
    """Says which neighbours are lost, so that waiting for them is useless."""

    def is_lost(self, j: int) -> bool:
        """Return True if j is LOST."""
        ...


class _FullMembership:
    """A membership without lost drones."""

    def is_lost(self, j: int) -> bool:
        return False


class ChannelTable:
    """The channels of one drone by their names, and the composition of its team.

    drone: id of the drone
    graph: communication graph, or a periodic sequence of graphs
    membership: says which drones are lost; None if no drone is

    Attributes:
    channels: {name: channel}
    epochs: the compositions of the team
    epoch_flags: flags of a message that tell the present epoch
    known: ids from which messages are accepted
    counters: counts of all channels
    """

    def __init__(
        self, drone: int, graph: AnyGraph, membership: Membership | None
    ) -> None:
        self.drone = drone
        self.membership: Membership = membership or _FullMembership()
        self.channels: dict[str, Channel] = {}
        self.counters = RoundCounters()
        self.epochs = Epochs(graph)
        self.epoch_flags = 0
        self.known = self.epochs.known

    def open(self, name: str, joinable: bool = False) -> Channel:
        """Return a channel; create it if needed.

        Raises ConfigError if the channel is already in use and not joinable, or if there are too
        many channels.
        """
        ch = self.channels.get(name)
        if ch is None:
            self._make_room(name)
            return self._begin(name, joinable)
        if joinable and not ch.joinable:
            if ch.used:
                raise ConfigError(
                    f"drone {self.drone}: channel {name!r}",
                    "joinable",
                    "open it as joinable before its first round",
                )
            return self._begin(name, joinable)
        return ch

    def _begin(self, name: str, joinable: bool) -> Channel:
        first = self.epochs.since if joinable else 0
        ch = Channel.beginning(name, self.counters, joinable, first)
        self.channels[name] = ch
        return ch

    def _make_room(self, name: str) -> None:
        """Remove a closed channel if there are too many; raise ConfigError if all are in use."""
        used = len(self.channels) - (FAILURE_CHANNEL in self.channels)
        if used < CHANNEL_LIMITS.most_open:
            return
        for closed, ch in self.channels.items():
            if ch.closed_at >= 0 and not ch.used:
                del self.channels[closed]
                return
        raise ConfigError(
            f"drone {self.drone}: channel {name!r}",
            used,
            f"{CHANNEL_LIMITS.most_open} channels at once",
            "Close some.",
        )

    def find_neighbors(self, ch: Channel, k: int) -> None:
        """Compute the neighbours in round k, and the rounds with the same ones."""
        graph = self.epochs.at(ch.joinable, k)
        ch.ins = graph.in_neighbors(self.drone)
        ch.outs = graph.out_neighbors(self.drone)
        ch.same_graph = range(k, self.epochs.until(ch.joinable, k))

    def is_absent(self, j: int) -> bool:
        """Return True if j has left or is lost."""
        return j in self.epochs.gone or self.membership.is_lost(j)

    # Epochs ---------------------------------------------------------------------------

    def replace_graph(self, graph: AnyGraph) -> None:
        """Use another graph, for all rounds."""
        self.epochs.replace(graph)
        self.known = self.epochs.known
        for ch in self.channels.values():
            ch.same_graph = range(0)

    def hold(self) -> int:
        """Send no further round of a joinable channel until the next epoch.

        Returns the first held round.
        """
        held = self.epochs.hold(
            [ch.sending for ch in self.channels.values() if ch.joinable]
        )
        for ch in self.channels.values():
            ch.limit = min(ch.limit, held) if ch.joinable else ch.limit
        return held

    def adopt(self, roster: Roster) -> None:
        """Put a roster in force: joinable channels change to its graph at its first round."""
        before = self.epochs.members
        if self.drone not in before:
            self.epochs.since = roster.first_round
        joined = roster.list_joined(before)
        self.epochs.renew(roster.members, roster.first_round)
        self.begin_epoch(
            roster.epoch,
            roster.list_absent(self.epochs.ids),
            joined,
            graph=roster.graph,
            first_round=roster.first_round,
        )

    def begin_epoch(
        self,
        epoch: int,
        gone: tuple[int, ...],
        joined: tuple[int, ...] = (),
        graph: Graph | None = None,
        first_round: int = 0,
    ) -> None:
        """Begin a new epoch: `joinable` channels continue with the
        remaining members, others raise RosterChanged.
        """
        self.epochs.begin(epoch, gone, joined, graph, first_round)
        self.known = self.epochs.known
        self.epoch_flags = epoch << EPOCH_SHIFT
        for ch in list(self.channels.values()):
            if ch.joinable:
                self._go_on(ch, (*gone, *joined))
            else:
                self._restart(ch, RosterChanged(self.drone, epoch, joined, gone))

    def _go_on(self, ch: Channel, changed: Iterable[int]) -> None:
        """Continue a joinable channel in a new epoch.

        changed: drones that have left or joined
        """
        ch.same_graph = range(0)
        ch.limit = ch.oldest
        ch.peers.forget(changed)
        missing = ch.wait.missing
        for j in [j for j in missing if self.epochs.silent(j, ch.receiving)]:
            del missing[j]
        if not missing:
            wake_if(ch.wait.waiter)
        wake_if(ch.gate)

    def _restart(self, ch: Channel, error: RosterChanged) -> None:
        """Replace the channel by a new one.

        A verb that is waiting on the old channel gets the error now; otherwise the next verb raises
        it.
        """
        new = self._begin(ch.name, False)
        if ch.wait.waiter is not None and not ch.wait.waiter.done():
            fail_waiter(ch, error)
        elif ch.gate is not None:
            ch.changed = error
            wake_if(ch.gate)
        elif ch.used:
            new.changed = error
