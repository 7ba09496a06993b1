"""The interface of a filter for a pilot."""

from typing import Protocol

from crazychoir.types import Pose, State, Vec


class StateFilter(Protocol):
    """Turns poses into states.

    The states are read-only: many readers share them.
    """

    commanded: Vec
    """(4,): thrust N and body rates rad/s that the drone obeys from now on.

    The sender of the commands sets it.
    """

    @property
    def horizon(self) -> float:
        """Longest prediction in s."""
        ...

    @property
    def measured(self) -> float:
        """Time in s of the last measurement."""
        ...

    @property
    def speed(self) -> float:
        """Speed in m/s of the newest state."""
        ...

    @property
    def refused(self) -> int:
        """Number of poses that were not used."""
        ...

    @property
    def cutoff(self) -> float:
        """rad/s, of the low-pass of a filter that differentiates poses; inf for other filters."""
        ...

    def update(self, pose: Pose, now: float) -> State | None:
        """Return the state at `now` with a new pose; None only before the first valid pose."""
        ...

    def predict(self, now: float) -> State | None:
        """Return the state at `now` without a new pose; None before the first."""
        ...
