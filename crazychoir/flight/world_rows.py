"""The drones of a world of this process: their poses and commands, without messages."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from crazychoir.control.rows import INPUT_SIZE
from crazychoir.filters.rows import FILTER_ROW, FilterRows
from crazychoir.flight.batch import DRONE_ROW, Batch, DroneRows
from crazychoir.numerics.kernels import (
    NO_COUNTING,
    bools,
    kernel,
    matrix,
    real,
    rows_of,
    table,
    wholes,
)
from crazychoir.types import Bools, CameraFrame, Ints, Mat

ABSENT_PLACE = -1
"""Place of a drone of the world that this process does not fly."""


class CommandTable(Protocol):
    """The commands of all drones of a world."""

    kinds: tuple[str, ...]
    """Kinds of commands that are written here; empty if the world takes no rows."""
    inputs: Mat
    """(n, 4): newest command of each drone."""
    is_new: Ints
    """(n,): 1 for a command that was written since the last step."""


@kernel(
    rows_of(DRONE_ROW), rows_of(FILTER_ROW), wholes, matrix, real, bools, **NO_COUNTING
)
def take_poses(
    drones: DroneRows,
    filters: FilterRows,
    places: Ints,
    flat: Mat,
    age: float,
    seen: Bools,
) -> None:
    """Write the poses of a frame into the records of the drones that may tick.

    drones: of the batch
    filters: of the batch
    places: (n,): places of the drones of the world in the batch
    flat: (n, 7): rows as Pose.flat
    age: s, of the poses
    seen: (n,): whether the cameras saw the drone
    """
    for r in range(places.shape[0]):
        k = places[r]
        if k == ABSENT_PLACE or not seen[r] or drones[k].is_running == 0:
            continue
        filters[k].has_pose = 1
        filters[k].pose_age = age
        for c in range(7):
            filters[k].pose[c] = flat[r, c]
        drones[k].ticks = 1


@kernel(rows_of(DRONE_ROW), rows_of(FILTER_ROW), wholes, table, wholes, **NO_COUNTING)
def send_inputs(
    drones: DroneRows, filters: FilterRows, places: Ints, inputs: Mat, is_new: Ints
) -> None:
    """Write the inputs of the drones that tick into the commands of their world.

    drones: of the batch
    filters: of the batch, which learn what is commanded
    places: (n,): places of the drones of the world in the batch
    inputs: (n, 4): commands of the world
    is_new: (n,): 1 for a new command
    """
    for r in range(places.shape[0]):
        k = places[r]
        if k == ABSENT_PLACE:
            continue
        drone = drones[k]
        is_computed = drone.ticks > 0 and drone.is_computed > 0
        if not is_computed or drone.has_world_row == 0:
            continue
        for c in range(INPUT_SIZE):
            inputs[r, c] = drone.command[c]
            if drone.knows_commands > 0:
                filters[k].command[c] = drone.command[c]
        is_new[r] = 1


class WorldRows:
    """The drones of one world of this process.

    batch: of the process
    ids: of the drones, in the order of the rows of the world
    commands: of the world
    make_due: lets the tick run in the next pass of the loop
    """

    def __init__(
        self,
        batch: Batch,
        ids: tuple[int, ...],
        commands: CommandTable,
        make_due: Callable[[], None],
    ) -> None:
        self._batch = batch
        self._commands = commands
        self._make_due = make_due
        found = [batch.places.get(i, ABSENT_PLACE) for i in ids]
        self._places = np.array(found, np.int64)

    def take_frame(self, frame: CameraFrame) -> None:
        """Take the poses of an exposure, in the order of the ids of the world."""
        batch = self._batch
        take_poses(
            batch.drones,
            batch.filters.rows,
            self._places,
            frame.flat,
            frame.age,
            frame.seen,
        )
        self._make_due()

    def send(self) -> None:
        """Give the world the inputs of this tick."""
        batch = self._batch
        send_inputs(
            batch.drones,
            batch.filters.rows,
            self._places,
            self._commands.inputs,
            self._commands.is_new,
        )
