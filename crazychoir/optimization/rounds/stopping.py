"""When a team stops: each agent has a criterion of its own, and a distributed logical and says when all hold."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from numbers import Integral
from typing import Any, Final, Generic, TypeVar

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.team.round import Round
from crazychoir.types import PerNeighbor, Vec

A = TypeVar("A", bound=Round)
NEVER: Final = 1 << 62


class Flags:
    """One agent's part of a distributed logical and over a graph of diameter D, as bits of one integer.

        s_i^0(k+1) = flag_i(k+1),   s_i^l(k+1) = s_i^(l-1)(k) and, over all j heard, s_j^(l-1)(k),   l = 1, ..., D

    s_i^l is the `and` of the flags, l rounds ago, of all within l hops; so s_i^D(k) = and_j flag_j(k - D) is the same
    at all agents, and all see it true in the same round, whether or not a flag falls again.
    Latched, s^l <- s^l or (s_i^(l-1) and s_j^(l-1) of all in-neighbours' latest), for agents that are not in step: true
    only if each flag has been up at some time.
    Source: after the logic-and of Farina, Garulli, Giannitrapani & Notarstefano 2019, Automatica 103, 243-253.
    """

    def __init__(self, diameter: int, flag: bool, latched: bool = False) -> None:
        given: Any = diameter
        if not isinstance(given, Integral) or diameter < 0:
            raise ConfigError(
                "logic-and: diameter", diameter, "0 or more: Graph.diameter()"
            )
        self._size = diameter // 8 + 1
        self._latched = latched
        self._mask = (2 << diameter) - 1
        self._top = 1 << diameter
        self.bits = int(flag)

    @property
    def agreed(self) -> bool:
        """Whether all flags are up."""
        return bool(self.bits & self._top)

    def message(self) -> bytes:
        """D + 1 bits."""
        return self.bits.to_bytes(self._size, "little")

    def step(self, flag: bool, heard: Mapping[int, bytes]) -> None:
        """flag: our own now;  heard: the messages of all in-neighbours."""
        common = self.bits
        for bits in heard.values():
            common &= int.from_bytes(bits, "little")
        new = (common << 1 | flag) & self._mask
        self.bits = new | self.bits if self._latched else new


class Settled:
    """A criterion: max |x(k) - x(k-1)| <= tolerance over the entries of x, so many rounds in a row. One for each agent.

    of: what of the algorithm, an array.
    compares: a criterion that compares with before. `Until` asks it of an asynchronous algorithm only when all
    neighbours have been heard anew since it last did: one that hears nothing does not change, but has not settled.
    """

    compares = True

    def __init__(
        self,
        tolerance: float,
        rounds: int = 1,
        of: Callable[[Any], Any] = lambda agent: agent.x,
    ) -> None:
        if not tolerance >= 0.0 or rounds < 1:
            raise ConfigError(
                "Settled",
                f"tolerance {tolerance:g}, {rounds} rounds",
                "0 or more, 1 or more",
            )
        self.tolerance = tolerance
        self.rounds = rounds
        self.of = of
        self._before: Vec | None = None
        self._calm = 0

    def __call__(self, agent: Any) -> bool:
        """Whether it is calm since so many rounds."""
        now = np.array(self.of(agent), dtype=float)
        still = self._before is not None and bool(
            np.all(np.abs(now - self._before) <= self.tolerance)
        )
        self._calm = self._calm + 1 if still else 0
        self._before = now
        return self._calm >= self.rounds


class LogicAnd:
    """Whether all agents' flags are up, as an algorithm of its own; all are done in the same round, D after the last.

    flag: may be set at any time;  diameter: of the graph, D, or on a sequence of graphs the rounds of a flood.
    Equation and source: see Flags.
    """

    connected = True

    asynchronous = False

    def __init__(self, diameter: int, flag: bool = False) -> None:
        self.flag = flag
        self.diameter = diameter
        self._flags = Flags(diameter, flag, latched=self.asynchronous)

    @property
    def done(self) -> bool:
        """Whether all flags are up."""
        return self._flags.agreed

    def message(self) -> bytes:
        """D + 1 bits."""
        return self._flags.message()

    def step(self, heard: Mapping[int, bytes]) -> None:
        """One hop more."""
        self._flags.step(self.flag, heard)


class AsynchronousLogicAnd(LogicAnd):
    """As LogicAnd, for agents that wake when they do; each is done when it knows. A flag that was up counts as up.

    neighbors: all whom this agent hears.
    """

    asynchronous = True

    def __init__(
        self, neighbors: tuple[int, ...], diameter: int, flag: bool = False
    ) -> None:
        super().__init__(diameter, flag)
        self.neighbors = neighbors

    def step(self, heard: Mapping[int, bytes]) -> None:
        """One hop more; who has not been heard yet has no flag."""
        super().step({**dict.fromkeys(self.neighbors, b""), **heard})


class Riding(Generic[A]):
    """An algorithm with a word of ours on each of its messages, also on one for each neighbour; a subclass says which.

    What is not found here is the algorithm's: `until.x` is `until.algorithm.x`.
    """

    def __init__(self, algorithm: A) -> None:
        self.algorithm = algorithm
        self.asynchronous = bool(getattr(algorithm, "asynchronous", False))
        self.heavy = bool(getattr(algorithm, "heavy", False))

    @abstractmethod
    def word(self) -> Any:
        """What rides on the next message."""

    @abstractmethod
    def hear(self, words: dict[int, Any]) -> None:
        """The neighbours' words, after the algorithm's step."""

    def message(self) -> Any:
        """[word, the algorithm's message]."""
        word = self.word()
        message = self.algorithm.message()
        if isinstance(message, PerNeighbor):
            return PerNeighbor({j: [word, value] for j, value in message.items()})
        return [word, message]

    def step(self, heard: Mapping[int, Any]) -> None:
        """The algorithm's step, then ours."""
        self.algorithm.step({j: value for j, (_, value) in heard.items()})
        self.hear({j: word for j, (word, _) in heard.items()})

    def __getattr__(self, name: str) -> Any:
        if name == "algorithm":
            raise AttributeError(name)
        return getattr(self.algorithm, name)


class Until(Riding[A]):
    """Any algorithm, until a criterion holds at all agents: a logical and rides on its messages, a byte for 8 hops.

    algorithm: also one that sends each neighbour its own, or is asynchronous (then neighbors: all whom it hears);
    criterion: of the algorithm after each step, such as `Settled(1e-6)`;  diameter: of the graph.
    A synchronous team stops in one round, D after all criteria held in one; an asynchronous one when each held once.
    The algorithm's own end counts, too.
    """

    def __init__(
        self,
        algorithm: A,
        criterion: Callable[[A], bool],
        diameter: int,
        neighbors: tuple[int, ...] | None = None,
    ) -> None:
        super().__init__(algorithm)
        if self.asynchronous and neighbors is None:
            raise ConfigError(
                "Until: neighbors",
                "None",
                "whom this agent hears, for an asynchronous algorithm",
            )
        self.criterion = criterion
        self.neighbors = neighbors or ()
        self.diameter = diameter
        self._flags = Flags(diameter, False, latched=self.asynchronous)
        self._steps, self._latest, self._silent = (
            0,
            dict[int, int](),
            set(self.neighbors),
        )

    @property
    def done(self) -> bool:
        """Whether all criteria hold, or the algorithm has ended."""
        return self._flags.agreed or self.algorithm.done

    def word(self) -> Any:
        """D + 1 bits; asynchronous: with the steps done, by which the others tell what is new."""
        bits = self._flags.message()
        return [self._steps, bits] if self.asynchronous else bits

    def hear(self, words: dict[int, Any]) -> None:
        """The criterion, and the logical and."""
        self._steps += 1
        if not self.asynchronous:
            self._flags.step(self.criterion(self.algorithm), words)
            return
        for j, (steps, _) in words.items():
            if steps > self._latest.get(j, -1):
                self._latest[j] = steps
                self._silent.discard(j)
        due = not self._silent or not getattr(self.criterion, "compares", False)
        holds = due and self.criterion(self.algorithm)
        self._silent = self._silent or set(self.neighbors)
        bits = {j: word for j, (_, word) in words.items()}
        self._flags.step(holds, {**dict.fromkeys(self.neighbors, b""), **bits})


class Stoppable(Riding[A]):
    """Any algorithm, until one agent calls `stop`: the round of the end rides on its messages, D rounds ahead.

        at_i <- min(at_i, min_j at_j);  the first to say it takes at_i = k + D, k its rounds done

    diameter: of the graph, D. All synchronous agents end in one round; asynchronous ones when they hear of it.
    """

    def __init__(self, algorithm: A, diameter: int) -> None:
        super().__init__(algorithm)
        self.diameter = diameter
        self.k = 0
        self.at = NEVER
        self._asked = False

    def stop(self) -> None:
        """End it, at all agents; may be called at any time."""
        self._asked = True

    @property
    def done(self) -> bool:
        """Whether the round of the end has come, or the algorithm has ended."""
        return self.k >= self.at or self.algorithm.done

    def word(self) -> int:
        """The round of the end."""
        if self._asked:
            self.at = min(self.at, 0 if self.asynchronous else self.k + self.diameter)
        return self.at

    def hear(self, words: dict[int, int]) -> None:
        """The earliest end."""
        self.k += 1
        self.at = min([self.at, *words.values()])
