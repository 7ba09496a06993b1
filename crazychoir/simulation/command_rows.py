"""The commands of all drones of a world as a table, which the world takes by one call a step."""

from dataclasses import dataclass
from typing import cast

import numpy as np

from crazychoir.simulation.common.world import DroneLink, RowWorld, World
from crazychoir.types import Command, Ints, Mat


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
        self._world = world
        self._step = 0
        self._late_inputs = np.zeros((delay + 1, n, 4))
        self._is_late = np.zeros((delay + 1, n), np.int64)
        self._slots = list(zip(self._late_inputs, self._is_late, strict=True))

    def discard(self, row: int) -> None:
        """Forget all commands in this row that have not taken effect."""
        self.is_new[row] = 0
        self._is_late[:, row] = 0

    def advance(self) -> None:
        """Begin a step of the world: give it the commands that are due."""
        if not self.kinds:
            return
        size = len(self._slots)
        inputs, is_new = self._slots[self._step % size]
        np.copyto(inputs, self.inputs)
        np.copyto(is_new, self.is_new)
        self.is_new.fill(0)
        self._step += 1
        inputs, is_new = self._slots[self._step % size]
        cast(RowWorld, self._world).take_commands(inputs, is_new)
        is_new.fill(0)


@dataclass
class RowLink:
    """The link to one drone that writes its commands to a row."""

    rows: CommandRows
    """The rows of the world."""
    row: int
    """Row of the drone."""
    link: DroneLink
    """The link of the world, without delay."""

    def send(self, command: Command) -> None:
        """Let the drone obey this command until the next one."""
        self.rows.inputs[self.row] = command.flat
        self.rows.is_new[self.row] = 1

    def cut(self) -> None:
        """Discard the commands that have not taken effect, and stop the motors for good."""
        self.rows.discard(self.row)
        self.link.cut()
