"""Routes of one vehicle by label setting.

The fast kernel is used if only lengths decide, otherwise the general one.
"""

from dataclasses import dataclass

import numpy as np

from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES, ROUNDING_SLACK, Vehicle
from crazychoir.routing.pricing.label_setting_windows import grow_fronts
from crazychoir.routing.pricing.labels import grow_labels
from crazychoir.types import Bools, Ints, Vec, Words


@dataclass(frozen=True, eq=False)
class FinalLabels:
    """The labels with nothing on board, each extended to the end of its route.

    A label is a partial route: its set of tasks, its last node, and its costs.
    """

    picked: Words
    """(n, 2) words: the tasks served."""
    length: Vec
    """(n,) m."""
    finish: Vec
    """(n,) s."""
    complete: bool
    """Whether no label is missing."""
    _label: Ints
    _last: Ints
    _parent: Ints
    _again: Bools | None

    @property
    def count(self) -> Ints:
        """(n,): number of tasks served."""
        return np.asarray(np.bitwise_count(self.picked).sum(axis=1), dtype=np.int64)

    def route(self, row: int, chosen: Ints, m: int) -> list[int]:
        """Return the nodes of the route of a label, in the numbers of the whole problem.

        row: number of the label.
        chosen: (k,): number, in the whole problem, of each of the k tasks of the labels.
        m: number of tasks of the whole problem.
        """
        nodes = []
        label = int(self._label[row])
        while self._parent[label] >= 0:
            at = int(self._last[label])
            nodes.append(
                int(chosen[at])
                if at < len(chosen)
                else m + int(chosen[at - len(chosen)])
            )
            if self._again is not None and self._again[label]:
                nodes.append(2 * m + 1)
            label = int(self._parent[label])
        return nodes[::-1]


def compute_final_labels(
    vehicle: Vehicle, most: int, objective: tuple[str, ...]
) -> FinalLabels:
    """Return, for each set of tasks, the routes that no other route of the same set dominates.

    vehicle: the robot, with at most MOST_TASKS tasks.
    most: largest number of labels.
    objective: names of the objectives, the most important first.
    The result is exact if `complete` is True.
    """
    if vehicle.timed or vehicle.trips > 1 or OBJECTIVE_NAMES.makespan in objective:
        return _label_by_fronts(vehicle, most, objective)
    return _label_by_length(vehicle, most)


def _label_by_length(vehicle: Vehicle, most: int) -> FinalLabels:
    m = vehicle.tasks
    way = vehicle.shortest
    rest = way[: 2 * m, m : 2 * m] + way[m : 2 * m, 2 * m + 1]
    keys, last, length, parent, complete = grow_labels(
        vehicle.distance,
        rest,
        np.ascontiguousarray(way[: 2 * m, 2 * m + 1]),
        vehicle.load,
        vehicle.aboard,
        vehicle.capacity + ROUNDING_SLACK,
        vehicle.limit + ROUNDING_SLACK,
        np.inf,
        most,
    )
    empty = (keys[:, 2] == 0) & (keys[:, 3] == 0)
    total = length[empty] + vehicle.distance[last[empty], 2 * m + 1]
    back = total <= vehicle.limit + ROUNDING_SLACK
    label = np.flatnonzero(empty)[back]
    finish = np.full(len(label), np.nan)
    return FinalLabels(
        keys[label, :2], total[back], finish, complete, label, last, parent, None
    )


def _label_by_fronts(
    vehicle: Vehicle, most: int, objective: tuple[str, ...]
) -> FinalLabels:
    m = vehicle.tasks
    end = 2 * m + 1
    limited = np.isfinite(vehicle.farthest)
    many = vehicle.trips > 1
    timed = vehicle.timed or OBJECTIVE_NAMES.makespan in objective
    counts = (
        OBJECTIVE_NAMES.total in objective or (limited and not many),
        timed,
        limited and many,
        many,
    )
    keys, last, state, parent, again, dead, complete = grow_fronts(
        vehicle.distance,
        vehicle.duration,
        vehicle.shortest,
        vehicle.fastest,
        vehicle.earliest,
        vehicle.latest + ROUNDING_SLACK,
        vehicle.load,
        vehicle.aboard,
        np.array(counts),
        vehicle.capacity + ROUNDING_SLACK,
        vehicle.limit + ROUNDING_SLACK,
        vehicle.limit_again + ROUNDING_SLACK,
        vehicle.trips,
        most,
    )
    empty = (keys[:, 2] == 0) & (keys[:, 3] == 0) & ~dead
    home = vehicle.distance[last, end]
    finish = np.maximum(
        state[:, 1] + vehicle.duration[last, end], vehicle.earliest[end]
    )
    label = np.flatnonzero(
        empty & (home <= state[:, 2]) & (finish <= vehicle.latest[end] + ROUNDING_SLACK)
    )
    length = state[label, 0] + home[label]
    return FinalLabels(
        keys[label, :2], length, finish[label], complete, label, last, parent, again
    )


def list_bits(words: Words) -> list[int]:
    """Return the set as a list, increasing."""
    value = int(words[0]) | int(words[1]) << 64
    return [b for b in range(value.bit_length()) if value >> b & 1]
