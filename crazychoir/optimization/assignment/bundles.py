"""Several tasks a robot, by bids: the consensus-based bundle algorithm, and a sequential auction of single tasks."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.rounds.agreement import best_offer
from crazychoir.optimization.rounds.messages import like, parts
from crazychoir.optimization.rounds.program import Exchange, Program
from crazychoir.optimization.rounds.stillness import Stillness
from crazychoir.types import Vec

NOBODY: Final = -1
ROUNDS = 10_000
Path = TypeVar("Path")


class Bidder(Protocol[Path]):
    """What a robot makes of tasks 0 to M - 1: the user's part."""

    start: Path
    """The path without any task."""

    def scores(self, path: Path) -> Vec:
        """(M,) what each task, added to the path where it fits best, is worth; -inf if it does not fit."""
        ...

    def insert(self, path: Path, task: int) -> Path:
        """The path with that task where it fits best."""
        ...


@dataclass(frozen=True)
class Bundle:
    """What a robot has in the end. tasks: in the order in which it took them;  path: with them;  winners: of all tasks,
    -1: nobody can do it;  rounds: in all.
    """

    tasks: tuple[int, ...]
    path: Any
    winners: tuple[int, ...]
    rounds: int

    @property
    def open_tasks(self) -> tuple[int, ...]:
        """Those that nobody does."""
        return tuple(j for j, winner in enumerate(self.winners) if winner == NOBODY)


def sequential_auction(
    robot: int, bidder: Bidder[Path], tasks: int, diameter: int
) -> Exchange[Bundle]:
    """One task after the other goes to the robot to which any is worth the most, together with what it has.

        (i, j) = argmax_ij c_ij(path_i),   path_i <- path_i with j;   until all c_ij are -inf

    D rounds an auction. Each robot bids for the one task that is worth the most to it; ties go to the lowest id.
    Source: Lagoudakis et al. 2005, RSS, "Auction-based multi-robot routing"; Koenig et al. 2006, AAAI.
    """
    path = bidder.start
    won = list[int]()
    rounds = 0
    winners = np.full(tasks, NOBODY)
    scores = _checked(bidder.scores(path), tasks, robot)
    while True:
        open_scores = np.where(winners == NOBODY, scores, -np.inf)
        best = int(np.argmax(open_scores)) if tasks else 0
        offer = (
            [-float(open_scores[best]), robot, best]
            if tasks and open_scores[best] > -np.inf
            else None
        )
        agreed = yield from best_offer(offer, diameter)
        rounds += diameter
        if agreed is None:
            return Bundle(tuple(won), path, tuple(winners.tolist()), rounds)
        _, winner, j = agreed
        winners[j] = winner
        if winner == robot:
            path = bidder.insert(path, j)
            won.append(j)
            scores = _checked(bidder.scores(path), tasks, robot)


class SequentialAuction(Program[Bundle]):
    """Robot i's part of a sequential auction of single tasks, see `sequential_auction`.

    tasks: M, the same at all robots;  diameter: D, of the graph, or rounds of a flood on a sequence of graphs.
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
        """The auctions."""
        return (yield from sequential_auction(*self._arguments))


class CBBA(Program[Bundle]):
    """Robot i's part of the consensus-based bundle algorithm.

    Each round: compare winning bids with the neighbours, by the paper's table; give up the first task of the bundle
    that is lost, and all that were taken after it; take tasks again while there is one for which the own bid wins:

        j = argmax_j c_j(path) over the j with (b_j, -i) > (y_j, -z_j),    b_j = min(c_j(path), bids in the bundle)

    y, z: (M,) the highest bid that is known for each task, and whose;  s: when each robot was heard of last.
    With the minimum of Johnson et al. it converges for any scores, and without it for those of diminishing gain; for
    these the result is the one of a sequential auction, at least half the best total.
    It ends 2 D + 1 rounds after the last change, at all in the same round.
    robots: ids of all;  tasks: M;  most: tasks a robot may have, None: any number;  diameter: D, of a connected graph
    that does not change.
    Raises ConfigError for scores that are not (M,) numbers, SolverError if it does not end.
    Source: Choi, Brunet & How 2009, IEEE T-RO 25(4), 912-926, table I; Johnson, Choi, Ponda & How 2012, CDC.
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
        self._table = Table(robot, tasks)
        self._order: list[int] = []
        self._paths = [bidder.start]
        super().__init__()

    def run(self) -> Exchange[Bundle]:
        """Bundle, then consensus and bundle again, until nobody changes."""
        table = self._table
        self._extend()
        for _ in range(ROUNDS):
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
            for j, (_, bid, winner, stamps) in parts(
                self._i, self.k, heard, bytes, object, object, object
            ).items():
                bids = like(self._i, j, bid, table.bid)
                winners = like(self._i, j, winner, table.winner)
                known = like(self._i, j, stamps, table.stamps(self._robots, self.k))
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
        raise SolverError(f"robot {self._i}: CBBA", f"no agreement in {ROUNDS} rounds")

    def _release(self) -> None:
        """The bundle up to the first task that is lost; what came after it is free again."""
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
            scores = _checked(
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


class Table:
    """Winning bids as one robot knows them, and the rules by which it takes what a neighbour says of them.

    bid: y (M,), -inf where there is none;  winner: z (M,), NOBODY.
    """

    def __init__(self, robot: int, tasks: int) -> None:
        self._i, self._stamp = robot, dict[int, int]()
        self.bid: Vec = np.full(tasks, -np.inf)
        self.winner: npt.NDArray[np.int64] = np.full(tasks, NOBODY)

    def stamps(self, robots: Sequence[int], k: int) -> npt.NDArray[np.int64]:
        """s: (N,) round of the latest news of each robot; of itself that is now."""
        self._stamp[self._i] = k
        return np.array([self._stamp.get(robot, -1) for robot in robots])

    def reset(self, j: int) -> None:
        """Nobody's."""
        self.bid[j] = -np.inf
        self.winner[j] = NOBODY

    def hear(
        self,
        sender: int,
        bid: Sequence[float],
        winner: Sequence[int],
        stamp: Mapping[int, int],
    ) -> None:
        """What the sender thinks of all tasks, and when it heard of each robot last."""
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
        """Whether the sender's winner is taken over. theirs, mine: who wins, as the sender and this robot think."""
        i = self._i
        if theirs == i:
            return False
        if theirs == sender:
            return (
                mine in (sender, NOBODY)
                or higher
                or (mine != i and self._newer(mine, stamp))
            )
        if theirs == NOBODY:
            return mine == sender or (
                mine not in (i, NOBODY) and self._newer(mine, stamp)
            )
        if not self._newer(theirs, stamp):
            return False
        others = mine not in (i, sender, theirs, NOBODY)
        return (
            mine in (sender, theirs, NOBODY)
            or higher
            or (others and self._newer(mine, stamp))
        )

    def _resets(
        self, sender: int, theirs: int, mine: int, stamp: Mapping[int, int]
    ) -> bool:
        """Whether nobody is known to win any more: both point at somebody who has given up, or at each other."""
        i = self._i
        if theirs == i:
            return mine == sender or (
                mine not in (i, NOBODY) and self._newer(mine, stamp)
            )
        if theirs in (sender, NOBODY):
            return False
        if mine == sender:
            return not self._newer(theirs, stamp)
        others = mine not in (i, sender, theirs, NOBODY)
        return (
            others
            and self._newer(mine, stamp)
            and self._stamp.get(theirs, -1) > stamp[theirs]
        )


def _checked(scores: Vec, tasks: int, robot: int) -> Vec:
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
