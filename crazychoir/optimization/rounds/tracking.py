"""The part that gradient tracking methods share: x, the tracker y, and the message of both."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from crazychoir.optimization.rounds.iteration import copy_state
from crazychoir.optimization.rounds.messages import check_parts
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, mix
from crazychoir.optimization.rounds.step_size import (
    GrowthWatch,
    StepSize,
    step_size,
)
from crazychoir.types import Vec


class Tracking(Mixing):
    """Gradient tracking with any estimate g_i of the gradient, and any direction d_i.

        x_i(k+1) = sum_j w_ij x_j(k) - a_k d_i(k)
        y_i(k+1) = sum_j w_ij y_j(k) + g_i(k+1) - g_i(k),   y_i(0) = g_i(0)

    A subclass writes `estimate` and `direction`, and sets y_i(0) by `track` in its constructor.
    """

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        step: float | StepSize,
        bound: str,
        rounds: int | None,
    ) -> None:
        super().__init__(i, weights, rounds)
        self.x = copy_state(f"agent {i}: x", x)
        self.step_size = step_size(step)
        self._watch = GrowthWatch(f"agent {i}", self.step_size, bound)

    def track(self, g: Vec) -> None:
        """Start the tracker from the first estimate g_i(0)."""
        self.g = g
        self.y = g

    @abstractmethod
    def estimate(self, k: int, x: Vec) -> Vec:
        """Return g_i, the estimate of the gradient at x in round k."""

    @abstractmethod
    def direction(self) -> Vec:
        """Return d_i from the tracker y_i."""

    def payload(self) -> list[Vec]:
        """Return [x_i, y_i]."""
        return [self.x, self.y]

    def mix_in(self, row: Row, heard: Mapping[int, Any]) -> None:
        """Average, move along the direction, and update the tracker."""
        check_parts(self.i, self.k, heard, object, object)
        x = mix(self.i, row, self.x, {j: theirs[0] for j, theirs in heard.items()})
        x = x - self.step_size(self.k) * self.direction()
        self._watch(self.k, x)
        g = self.estimate(self.k, x)
        y = mix(self.i, row, self.y, {j: theirs[1] for j, theirs in heard.items()})
        self.y = y + g - self.g
        self.x = x
        self.g = g
