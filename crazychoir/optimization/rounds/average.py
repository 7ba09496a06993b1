"""Running averages of iterates.

For some algorithms the averages become primal feasible, or converge, but the iterates do not.
"""

from crazychoir.errors import ConfigError
from crazychoir.types import Vec


class RunningAverage:
    """The weighted average of all values so far.

        s_k = s_(k-1) + a_k,   y_k = y_(k-1) + (a_k / s_k) (x_k - y_(k-1))
        so that y_k = sum a_t x_t / sum a_t

    value: y
    weight: s
    """

    def __init__(self) -> None:
        self.weight = 0.0
        self.value: Vec | None = None

    def add(self, x: Vec, a: float = 1.0) -> Vec:
        """Add x with weight a > 0, and return the average."""
        if not a > 0.0:
            raise ConfigError("running average: weight", a, "above 0")
        self.weight += a
        before = x if self.value is None else self.value
        average = self.value = before + (a / self.weight) * (x - before)
        return average
