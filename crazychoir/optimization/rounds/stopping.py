"""Stop a team when the criteria of all agents hold, by a distributed logical AND."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from numbers import Integral
from typing import Any, Final, Generic, TypeVar

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.team.round import Round
from crazychoir.types import PerNeighbor, Vec

A = TypeVar("A", bound=Round)
NEVER_REACHED_ROUND: Final = 1 << 62
"""A round that is never reached."""


class Flags:
    """One agent's part of a distributed logical AND over a graph of diameter D.

    The states s_i^0, ..., s_i^D are the bits of one integer.

        s_i^0(k+1) = flag_i(k+1)
        s_i^l(k+1) = s_i^(l-1)(k) and, over all j heard, s_j^(l-1)(k),   l = 1, ..., D

    s_i^l is the `and` of the flags, l rounds ago, of all agents within l hops. So
    s_i^D(k) = and_j flag_j(k - D) is the same at all agents. All agents see it true in the same
    round, even if a flag falls again.

    Latched, for agents that are not in step:

        s^l <- s^l or (s_i^(l-1) and the latest s_j^(l-1) of all in-neighbours)

    It becomes true only if each flag has been up at some time.

    diameter: D
    flag: first value of this agent's flag
    latched: use the latched rule
    Source: after the logic-and of Farina, Garulli, Giannitrapani & Notarstefano 2019,
    Automatica 103, 243-253.
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
        """True if all flags are up."""
        return bool(self.bits & self._top)

    def message(self) -> bytes:
        """Return the D + 1 bits."""
        return self.bits.to_bytes(self._size, "little")

    def step(self, flag: bool, heard: Mapping[int, bytes]) -> None:
        """Compute one round.

        flag: the flag of this agent now
        heard: the messages of all in-neighbours
        """
        common = self.bits
        for bits in heard.values():
            common &= int.from_bytes(bits, "little")
        new = (common << 1 | flag) & self._mask
        self.bits = new | self.bits if self._latched else new


class Settled:
    """A criterion: max |x(k) - x(k-1)| <= tolerance over the entries of x.

    It must hold for several rounds in a row.

    Make one for each agent.

    tolerance: largest change of an entry
    rounds: number of rounds in a row in which the change must be small
    of: returns the array to watch, given the algorithm
    compares: True says that the criterion compares with an earlier value. `Until` then evaluates it
        for an asynchronous algorithm only after new messages of all neighbours. An agent that hears
        nothing does not change, but has not settled.
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
        """Return True if x has been still for `rounds` rounds."""
        now = np.array(self.of(agent), dtype=float)
        still = self._before is not None and bool(
            np.all(np.abs(now - self._before) <= self.tolerance)
        )
        self._calm = self._calm + 1 if still else 0
        self._before = now
        return self._calm >= self.rounds


class LogicAnd:
    """An algorithm that ends when the flags of all agents are up.

    All agents are done in the same round, D rounds after the last flag went up.

    diameter: D, the diameter of the graph; on a sequence of graphs the rounds of a flood
    flag: flag of this agent; may be set at any time
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
        """True if all flags are up."""
        return self._flags.agreed

    def message(self) -> bytes:
        """Return the D + 1 bits."""
        return self._flags.message()

    def step(self, heard: Mapping[int, bytes]) -> None:
        """Move the flags one hop further."""
        self._flags.step(self.flag, heard)


class AsynchronousLogicAnd(LogicAnd):
    """LogicAnd for agents that wake at different times.

    Each agent is done when it knows the result.

    A flag that has been up once counts as up.

    neighbors: all agents that this agent hears
    """

    asynchronous = True

    def __init__(
        self, neighbors: tuple[int, ...], diameter: int, flag: bool = False
    ) -> None:
        super().__init__(diameter, flag)
        self.neighbors = neighbors

    def step(self, heard: Mapping[int, bytes]) -> None:
        """Move the flags one hop further; a neighbour that was not heard yet has no flag."""
        super().step({**dict.fromkeys(self.neighbors, b""), **heard})


class MessageRider(Generic[A]):
    """An algorithm with an extra word on each of its messages; a subclass defines the word.

    The word is also added to messages that differ by neighbour.
    An attribute that is not found here is read from the algorithm: `until.x` is
    `until.algorithm.x`.
    """

    def __init__(self, algorithm: A) -> None:
        self.algorithm = algorithm
        self.asynchronous = bool(getattr(algorithm, "asynchronous", False))
        self.heavy = bool(getattr(algorithm, "heavy", False))

    @abstractmethod
    def word(self) -> Any:
        """Return the extra word of the next message."""

    @abstractmethod
    def hear(self, words: dict[int, Any]) -> None:
        """Take the words of the neighbours, after the algorithm's step."""

    def message(self) -> Any:
        """Return [word, message of the algorithm]."""
        word = self.word()
        message = self.algorithm.message()
        if isinstance(message, PerNeighbor):
            return PerNeighbor({j: [word, value] for j, value in message.items()})
        return [word, message]

    def step(self, heard: Mapping[int, Any]) -> None:
        """Do the algorithm's step, then take the words."""
        self.algorithm.step({j: value for j, (_, value) in heard.items()})
        self.hear({j: word for j, (word, _) in heard.items()})

    def __getattr__(self, name: str) -> Any:
        if name == "algorithm":
            raise AttributeError(name)
        return getattr(self.algorithm, name)


class Until(MessageRider[A]):
    """Run any algorithm until a criterion holds at all agents.

    A logical AND travels with the messages: one byte for 8 hops.
    A synchronous team stops in one round, D rounds after the criteria of all agents held together.
    An asynchronous agent stops when it knows that each criterion held once.
    The end of the algorithm itself also ends it.

    algorithm: any algorithm, also an asynchronous one, or one with messages that differ by
        neighbour
    criterion: evaluated on the algorithm after each step, such as `Settled(1e-6)`
    diameter: D, the diameter of the graph
    neighbors: all agents that this agent hears; needed for an asynchronous algorithm
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
                "the agents that this agent hears, for an asynchronous algorithm",
            )
        self.criterion = criterion
        self.neighbors = neighbors or ()
        self.diameter = diameter
        self._flags = Flags(diameter, False, latched=self.asynchronous)
        self._steps = 0
        self._latest = dict[int, int]()
        self._silent = set(self.neighbors)

    @property
    def done(self) -> bool:
        """True if all criteria hold, or if the algorithm has ended."""
        return self._flags.agreed or self.algorithm.done

    def word(self) -> Any:
        """Return the D + 1 bits.

        An asynchronous agent adds the number of its steps, so that receivers recognise new
        messages.
        """
        bits = self._flags.message()
        return [self._steps, bits] if self.asynchronous else bits

    def hear(self, words: dict[int, Any]) -> None:
        """Evaluate the criterion, and advance the logical AND."""
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


class Stoppable(MessageRider[A]):
    """Run any algorithm until one agent calls `stop`.

    The round of the end travels with the messages, D rounds ahead:

        at_i <- min(at_i, min_j at_j),   and at_i = k + D at the agent that stops, k its rounds done

    All synchronous agents end in the same round. Asynchronous agents end when they learn of it.

    algorithm: any algorithm
    diameter: D, the diameter of the graph
    """

    def __init__(self, algorithm: A, diameter: int) -> None:
        super().__init__(algorithm)
        self.diameter = diameter
        self.k = 0
        self.at = NEVER_REACHED_ROUND
        self._asked = False

    def stop(self) -> None:
        """End the algorithm at all agents; may be called at any time."""
        self._asked = True

    @property
    def done(self) -> bool:
        """True when the round of the end has come, or when the algorithm has ended."""
        return self.k >= self.at or self.algorithm.done

    def word(self) -> int:
        """Return the round of the end."""
        if self._asked:
            self.at = min(self.at, 0 if self.asynchronous else self.k + self.diameter)
        return self.at

    def hear(self, words: dict[int, int]) -> None:
        """Take the earliest round of the end."""
        self.k += 1
        self.at = min([self.at, *words.values()])
