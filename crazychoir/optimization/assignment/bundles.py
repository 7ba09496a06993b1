"""Assign several tasks to each robot by bids.

The methods are the consensus-based bundle algorithm, and a sequential auction of single tasks.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.rounds.agreement import find_best_offer
from crazychoir.optimization.rounds.messages import check_array, check_parts
from crazychoir.optimization.rounds.program import Exchange, Program
from crazychoir.optimization.rounds.stillness import Stillness
from crazychoir.types import Vec

NO_WINNER: Final = -1
"""Winner of a task without a bid."""
MOST_CBBA_ROUNDS = 10_000
"""Largest number of rounds of CBBA."""
Path = TypeVar("Path")


class Bidder(Protocol[Path]):
    """The user's part: how a robot values tasks 0 to M - 1."""

    start: Path
    """The path without any task."""

    def scores(self, path: Path) -> Vec:
        """Return (M,) the value of each task at its best place in the path.

        The value is -inf if the task does not fit.
        """
        ...

    def insert(self, path: Path, task: int) -> Path:
        """Return the path with the task at its best place."""
        ...


@dataclass(frozen=True)
class Bundle:
    """The tasks of a robot at the end."""

    tasks: tuple[int, ...]
    """Tasks in the order in which the robot took them."""
    path: Any
    """Path with these tasks."""
    winners: tuple[int, ...]
    """Winner of each task, -1 if no robot can do it."""
    rounds: int
    """Number of rounds in all."""

    @property
    def open_tasks(self) -> tuple[int, ...]:
        """Tasks without a winner."""
        return tuple(j for j, winner in enumerate(self.winners) if winner == NO_WINNER)


def run_sequential_auction(
    robot: int, bidder: Bidder[Path], tasks: int, diameter: int
) -> Exchange[Bundle]:
    """Assign one task after the other to the robot with the highest value.

        (i, j) = argmax_ij c_ij(path_i),   path_i <- path_i with j;   until all c_ij are -inf

    The value of a task includes the tasks that the robot has already. An auction takes D rounds. In
    each auction a robot bids for its most valuable task. At equal bids the lowest id wins.
    Source: Lagoudakis et al. 2005, RSS, "Auction-based multi-robot routing"; Koenig et al. 2006,
    AAAI.
    """
    path = bidder.start
    won = list[int]()
    rounds = 0
    winners = np.full(tasks, NO_WINNER)
    scores = _check_scores(bidder.scores(path), tasks, robot)
    while True:
        open_scores = np.where(winners == NO_WINNER, scores, -np.inf)
        best = int(np.argmax(open_scores)) if tasks else 0
        offer = (
            [-float(open_scores[best]), robot, best]
            if tasks and open_scores[best] > -np.inf
            else None
        )
        agreed = yield from find_best_offer(offer, diameter)
        rounds += diameter
        if agreed is None:
            return Bundle(tuple(won), path, tuple(winners.tolist()), rounds)
        _, winner, j = agreed
        winners[j] = winner
        if winner == robot:
            path = bidder.insert(path, j)
            won.append(j)
            scores = _check_scores(bidder.scores(path), tasks, robot)


class SequentialAuction(Program[Bundle]):
    """Robot i's part of a sequential auction of single tasks, see `run_sequential_auction`.

    robot: id of this robot
    bidder: values of the tasks
    tasks: M, the number of tasks, the same at all robots
    diameter: D of the graph, or the rounds of a flood on a sequence of graphs
    Raises ConfigError for scores that are not (M,) numbers.
    """

    heavy = True
    connected = True

    def __init__(
        self, robot: int, bidder: Bidder[Any], tasks: int, diameter: int
    ) -> None:
        self._arguments = (robot, bidder, tasks, diameter)
        self.diameter = diameter
        super().__init__()

    def run(self) -> Exchange[Bundle]:
        """Run the auctions."""
        return (yield from run_sequential_auction(*self._arguments))


class CBBA(Program[Bundle]):
    """Robot i's part of the consensus-based bundle algorithm.

    Each round has three parts:

    1. Compare the winning bids with those of the neighbours, by the paper's table.
    2. Give up the first task of the bundle that is lost, and all tasks that were taken after it.
    3. Take tasks again while the robot's own bid wins one:

        j = argmax_j c_j(path) over the j with (b_j, -i) > (y_j, -z_j)
        b_j = min(c_j(path), bids in the bundle)

    y (M,) is the highest known bid for each task, and z (M,) the robot that made it. s is the round
    of the latest news of each robot.
    With the minimum of Johnson et al. it converges for any scores. Without the minimum it converges
    for scores of diminishing gain. For these the result is that of a sequential auction, which is
    at least half of the best total.
    It ends 2 D + 1 rounds after the last change, at all robots in the same round.

    robot: id of this robot
    bidder: values of the tasks
    robots: ids of all robots
    tasks: M, the number of tasks
    diameter: D of a connected graph that does not change
    most: largest number of tasks of this robot; None for any number
    Raises ConfigError for scores that are not (M,) numbers.
    Raises SolverError if it does not end.
    Source: Choi, Brunet & How 2009, IEEE T-RO 25(4), 912-926, table I; Johnson, Choi, Ponda & How
    2012, CDC.
    """

    heavy = True
    connected = True
    undirected = True

    def __init__(
        self,
        robot: int,
        bidder: Bidder[Any],
        robots: Sequence[int],
        tasks: int,
        diameter: int,
        most: int | None = None,
    ) -> None:
        if robot not in robots:
            raise ConfigError(
                f"robot {robot}: CBBA",
                f"robots {list(robots)}",
                "ids of all, its own too",
            )
        self._i = robot
        self._bidder = bidder
        self._robots = sorted(robots)
        self._tasks = tasks
        self._most = tasks if most is None else most
        self.diameter = diameter
        self._stillness = Stillness(diameter)
        self._table = BidTable(robot, tasks)
        self._order: list[int] = []
        self._paths = [bidder.start]
        super().__init__()

    def run(self) -> Exchange[Bundle]:
        """Build a bundle; then agree and build again, until no robot changes."""
        table = self._table
        self._extend()
        for _ in range(MOST_CBBA_ROUNDS):
            if self._stillness.reached:
                return Bundle(
                    tuple(self._order),
                    self._paths[-1],
                    tuple(table.winner.tolist()),
                    self.k,
                )
            before = table.bid.tobytes(), table.winner.tobytes(), tuple(self._order)
            heard = yield [
                self._stillness.message(),
                table.bid,
                table.winner,
                table.stamps(self._robots, self.k),
            ]
            for j, (_, bid, winner, stamps) in check_parts(
                self._i, self.k, heard, bytes, object, object, object
            ).items():
                bids = check_array(self._i, j, bid, table.bid)
                winners = check_array(self._i, j, winner, table.winner)
                known = check_array(
                    self._i, j, stamps, table.stamps(self._robots, self.k)
                )
                table.hear(
                    j,
                    bids.tolist(),
                    winners.tolist(),
                    dict(zip(self._robots, known.tolist(), strict=True)),
                )
            self._release()
            self._extend()
            changed = before != (
                table.bid.tobytes(),
                table.winner.tobytes(),
                tuple(self._order),
            )
            self._stillness.step(
                changed, {j: message[0] for j, message in heard.items()}
            )
        raise SolverError(
            f"robot {self._i}: CBBA", f"no agreement in {MOST_CBBA_ROUNDS} rounds"
        )

    def _release(self) -> None:
        """Keep the bundle up to the first lost task, and release the tasks after it."""
        table = self._table
        kept = next(
            (n for n, j in enumerate(self._order) if table.winner[j] != self._i),
            len(self._order),
        )
        for j in self._order[kept:]:
            if table.winner[j] == self._i:
                table.reset(j)
        del self._order[kept:], self._paths[kept + 1 :]

    def _extend(self) -> None:
        table = self._table
        ceiling = min((float(table.bid[j]) for j in self._order), default=math.inf)
        while len(self._order) < self._most:
            scores = _check_scores(
                self._bidder.scores(self._paths[-1]), self._tasks, self._i
            )
            bids = np.minimum(scores, ceiling)
            own = table.winner == self._i
            wins = (bids > table.bid) | (
                (bids == table.bid) & (self._i < table.winner)
            ) & (scores > -np.inf)
            worth = np.where(wins & ~own, scores, -np.inf)
            j = int(np.argmax(worth)) if self._tasks else 0
            if not self._tasks or worth[j] == -np.inf:
                return
            self._paths.append(self._bidder.insert(self._paths[-1], j))
            self._order.append(j)
            ceiling = float(bids[j])
            table.bid[j] = ceiling
            table.winner[j] = self._i


class BidTable:
    """Winning bids as one robot knows them, with the rules to update them.

    bid: y (M,), -inf where there is no bid
    winner: z (M,), -1 where there is no bid
    """

    def __init__(self, robot: int, tasks: int) -> None:
        self._i, self._stamp = robot, dict[int, int]()
        self.bid: Vec = np.full(tasks, -np.inf)
        self.winner: npt.NDArray[np.int64] = np.full(tasks, NO_WINNER)

    def stamps(self, robots: Sequence[int], k: int) -> npt.NDArray[np.int64]:
        """Return s (N,): the round of the latest news of each robot; for this robot it is k."""
        self._stamp[self._i] = k
        return np.array([self._stamp.get(robot, -1) for robot in robots])

    def reset(self, j: int) -> None:
        """Clear the winner of task j."""
        self.bid[j] = -np.inf
        self.winner[j] = NO_WINNER

    def hear(
        self,
        sender: int,
        bid: Sequence[float],
        winner: Sequence[int],
        stamp: Mapping[int, int],
    ) -> None:
        """Take a neighbour's view of all tasks.

        sender: id of the neighbour
        bid: its y
        winner: its z
        stamp: its s, by robot
        """
        for j, (y, z) in enumerate(zip(bid, winner, strict=True)):
            mine = int(self.winner[j])
            higher = (y, -z) > (float(self.bid[j]), -mine)
            if self._updates(sender, z, mine, higher, stamp):
                self.bid[j] = y
                self.winner[j] = z
            elif self._resets(sender, z, mine, stamp):
                self.reset(j)
        for robot, k in stamp.items():
            if robot != self._i:
                self._stamp[robot] = max(k, self._stamp.get(robot, -1))

    def _newer(self, robot: int, stamp: Mapping[int, int]) -> bool:
        return stamp[robot] > self._stamp.get(robot, -1)

    def _updates(
        self,
        sender: int,
        theirs: int,
        mine: int,
        higher: bool,
        stamp: Mapping[int, int],
    ) -> bool:
        """Return True if the sender's winner replaces this robot's winner.

        theirs: winner according to the sender
        mine: winner according to this robot
        higher: True if the sender's bid is higher
        """
        i = self._i
        if theirs == i:
            return False
        if theirs == sender:
            return (
                mine in (sender, NO_WINNER)
                or higher
                or (mine != i and self._newer(mine, stamp))
            )
        if theirs == NO_WINNER:
            return mine == sender or (
                mine not in (i, NO_WINNER) and self._newer(mine, stamp)
            )
        if not self._newer(theirs, stamp):
            return False
        others = mine not in (i, sender, theirs, NO_WINNER)
        return (
            mine in (sender, theirs, NO_WINNER)
            or higher
            or (others and self._newer(mine, stamp))
        )

    def _resets(
        self, sender: int, theirs: int, mine: int, stamp: Mapping[int, int]
    ) -> bool:
        """Return True if the winner must be cleared.

        This is so if each robot takes the other one for the winner, or if news says that the known
        winner has given the task up.
        """
        i = self._i
        if theirs == i:
            return mine == sender or (
                mine not in (i, NO_WINNER) and self._newer(mine, stamp)
            )
        if theirs in (sender, NO_WINNER):
            return False
        if mine == sender:
            return not self._newer(theirs, stamp)
        others = mine not in (i, sender, theirs, NO_WINNER)
        return (
            others
            and self._newer(mine, stamp)
            and self._stamp.get(theirs, -1) > stamp[theirs]
        )


def _check_scores(scores: Vec, tasks: int, robot: int) -> Vec:
    found = np.asarray(scores, dtype=float)
    if found.shape != (tasks,):
        raise ConfigError(
            f"robot {robot}: scores", f"shape {found.shape}", f"({tasks},), one a task"
        )
    bad = np.flatnonzero(np.isnan(found) | (found == np.inf))
    if len(bad):
        allowed = "a number, or -inf: not possible"
        raise ConfigError(
            f"robot {robot}: score of task {bad[0]}", f"{found[bad[0]]}", allowed
        )
    return found
