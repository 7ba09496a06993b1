"""What a pilot needs of a filter."""

from typing import Protocol

from crazychoir.types import Pose, State, Vec


class StateFilter(Protocol):
    """Poses in, states out. The states are read-only: many read the same.

    commanded: (4,) = thrust N, body rates rad/s, that the drone obeys from now on, told by whoever commands it;
    horizon: s, how far a prediction goes at most;  measured: s, the instant of the last measurement;
    speed: m/s, of the newest state;  refused: poses that came and were not taken;  cutoff: rad/s, of the low-pass
    behind which velocities are derivatives, inf if they are not.
    """

    commanded: Vec
    horizon: float
    measured: float
    speed: float
    refused: int
    cutoff: float

    def update(self, pose: Pose, now: float) -> State | None:
        """The state at `now` with a new pose; None only before the first pose that counts."""
        ...

    def predict(self, now: float) -> State | None:
        """The state at `now` when no pose has come; None before the first."""
        ...
