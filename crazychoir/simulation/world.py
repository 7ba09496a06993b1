"""What every engine of a simulated world can do, so that missions do not know which one flies them."""

from collections.abc import Sequence
from typing import Protocol

from crazychoir.math3d import Mat, Vec
from crazychoir.types import State


class World(Protocol):
    """All drones that one process simulates, advanced together by one `step` of dt.

    ids: the drones, row by row;  time: s;  states: (N, 13), rows laid out as State.flat, changed in place by `step`.
    """

    ids: tuple[int, ...]
    dt: float
    states: Mat

    @property
    def time(self) -> float:
        """s since the start."""
        ...

    def command(self, i: int, u: Vec | Sequence[float]) -> None:
        """Hold u (4,) = thrust N, rates rad/s for drone i from now on."""
        ...

    def cut(self, i: int) -> None:
        """Stop the motors of drone i for good."""
        ...

    def step(self) -> None:
        """Advance every drone by dt."""
        ...

    def state(self, i: int) -> State:
        """The truth about drone i, a copy."""
        ...

    def min_separation(self) -> float:
        """m, the smallest distance between two drones; inf for one drone."""
        ...
