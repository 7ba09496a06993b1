"""The commands of all drones of a world as a table, which the world takes by one call a step."""

from collections import deque
from dataclasses import dataclass
from typing import cast

import numpy as np

from crazychoir.simulation.common.world import DroneLink, RowWorld, World
from crazychoir.types import Command, Ints, Mat


@dataclass(frozen=True, slots=True)
class _LinkCommand:
    """A command on its way to the link of a drone."""

    due: int
    """Step of the world that it takes effect before."""
    row: int
    """Row of the drone."""
    link: DroneLink
    """The link of the world, without delay."""
    command: Command
    """The command."""


class CommandRows:
    """The newest commands of the drones of one world, a row a drone, with their delay.

    A command that is written before step k takes effect at step k + delay. A newer command of the
    same step replaces it.

    world: the world; `takes_rows` names the kinds of commands that it takes as rows
    delay: steps by which commands are late
    """

    def __init__(self, world: World, delay: int = 0) -> None:
        n = len(world.ids)
        self.kinds: tuple[str, ...] = getattr(world, "takes_rows", ())
        """Kinds of commands that are written here; empty if the world takes no rows."""
        self.inputs: Mat = np.zeros((n, 4))
        """(n, 4): newest command of each drone, laid out as its `flat`."""
        self.is_new: Ints = np.zeros(n, np.int64)
        """(n,): 1 for a command that was written since the last step."""
        # It is one where it has `kinds`; elsewhere it is not asked to take rows.
        self._world = cast(RowWorld, world)
        self.delay = delay
        """Steps by which commands are late."""
        self._step = 0
        self._others: deque[_LinkCommand] = deque()
        self._late_inputs = np.zeros((delay + 1, n, 4))
        self._is_late = np.zeros((delay + 1, n), np.int64)
        self._slots = list(zip(self._late_inputs, self._is_late, strict=True))

    def send_by_link(self, row: int, link: DroneLink, command: Command) -> None:
        """Replace the newest command in this row by a command of a kind that is not written here.

        link: the link of the world, without delay
        """
        self.is_new[row] = 0
        due = self._step + self.delay
        self._others.append(_LinkCommand(due, row, link, command))

    def discard(self, row: int) -> None:
        """Forget all commands in this row that have not taken effect."""
        self.is_new[row] = 0
        self._is_late[:, row] = 0
        self._others = deque(other for other in self._others if other.row != row)

    def advance(self) -> None:
        """Begin a step of the world: give it the commands that are due."""
        if not self.kinds:
            return
        while self._others and self._others[0].due <= self._step:
            other = self._others.popleft()
            other.link.send(other.command)
        size = len(self._slots)
        inputs, is_new = self._slots[self._step % size]
        inputs[:] = self.inputs
        is_new[:] = self.is_new
        self.is_new.fill(0)
        self._step += 1
        inputs, is_new = self._slots[self._step % size]
        self._world.take_commands(inputs, is_new)
        is_new.fill(0)


@dataclass
class RowLink:
    """The link to one drone that writes its commands to a row.

    Commands of other kinds, such as the landing of a drone without an agent, go to the link of the
    world with the same delay.
    """

    rows: CommandRows
    """The rows of the world."""
    row: int
    """Row of the drone."""
    link: DroneLink
    """The link of the world, without delay."""
    types: tuple[type[Command], ...]
    """Types of commands that are written to the row."""

    def send(self, command: Command) -> None:
        """Let the drone obey this command until the next one."""
        if not isinstance(command, self.types):
            self.rows.send_by_link(self.row, self.link, command)
            return
        self.rows.inputs[self.row] = command.flat
        self.rows.is_new[self.row] = 1

    def cut(self) -> None:
        """Discard the commands that have not taken effect, and stop the motors for good."""
        self.rows.discard(self.row)
        self.link.cut()
