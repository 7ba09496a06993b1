"""What a law hears of one neighbour, step by step, such that a lost message leaves no trace in what the law sums up."""

import math

from crazychoir.runtime.mailbox import Latest
from crazychoir.types import State, Vec


class Hearing:
    """The states of one neighbour as a law takes them, once a step.

    In a step without a new message the newest state is moved on, p + v age. Velocities are low-passed derivatives of
    measured places,

        v_k = e v_k-1 + (1 - e) (p_k - p_k-1) / h,  e = exp(-cutoff h)

    so the noise in the sum of all of them is that of two places; in the sum of those that arrive it is a random walk,
    on which a law that sums up velocities drifts by centimetres. The first state after a gap therefore tells the
    velocity with which the sum is right again, whatever was lost between messages a and b:

        h (v_a+1 + ... + v_b) = p_b - p_a - T (v_b - v_a),  T = h e / (1 - e) + latency

    box: of the neighbour's states;  period: s of the law;  cutoff: rad/s of the neighbour's filter;  h: s between its
    poses;  latency: s by which its filter has moved them on.
    """

    def __init__(self, box: Latest[State], period: float, cutoff: float, h: float, latency: float = 0.0) -> None:
        self.box, self.period = box, period
        self.lag = h / math.expm1(cutoff * h) + latency
        self._version = 0
        self._last: Vec | None = None  # the last message
        self._told: Vec | None = None  # m, the sum of what was told since the last message before the gap

    def start(self) -> None:
        """Steps begin now, or some were left out: there is nothing to make up for."""
        self._last = self._told = None

    def state(self) -> State | None:
        """The neighbour's state for this step, with the age of the message; None if that is too old."""
        state, age = self.box.fresh_with_age()
        new, self._version = self.box.version - self._version, self.box.version
        if state is None:
            self.start()
            return None
        flat, last = state.flat, self._last
        if new == 0 and last is not None:
            told = self.period * flat[3:6]
            self._told = told if self._told is None else self._told + told
            return State(moved_on(flat, age), age)
        self._last = flat
        if last is None or (new == 1 and self._told is None):
            return State(flat, age)
        caught_up = flat.copy()
        caught_up[3:6] = self._due(last, flat) / self.period
        self._told = None
        return State(caught_up, age)

    def _due(self, before: Vec, now: Vec) -> Vec:
        """m, by which the sum of velocities lacks what lies between two messages."""
        due = now[0:3] - before[0:3] - self.lag * (now[3:6] - before[3:6])
        return due if self._told is None else due - self._told


def moved_on(flat: Vec, age: float) -> Vec:
    """A state (13,) as it is `age` s later at constant velocity, attitude and body rates left as they were."""
    now = flat.copy()
    now[0:3] += age * now[3:6]
    return now
