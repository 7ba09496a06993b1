"""What a law is told of its own state and of its neighbours', such that late, lost and repeated ones leave no trace."""

import math

import numpy as np

from crazychoir.math3d import Vec, kernel, memory, real, vector
from crazychoir.runtime.mailbox import Latest
from crazychoir.types import State

SPREAD = 10.0  # steps within which a law is told what the velocities so far have lacked


@kernel(vector, real, real, real, real, memory)
def _settle(x: Vec, reach: float, held: float, spread: float, new: float, mem: Vec) -> None:
    """The law of VelocitySum; mem: (9,) = place P of the newest state, velocity that is told, owed m."""
    for c in range(3):
        v = x[3 + c]
        place = x[c] - reach * v
        owed = mem[6 + c] - held * mem[3 + c]
        mem[3 + c] = v
        if new > 0.0:
            owed += place - mem[c]
            owed = owed if held < 2.0 * spread and math.isfinite(owed) else 0.0
            mem[c] = place
            mem[3 + c] += owed / spread
        mem[6 + c] = owed


class VelocitySum:
    """Keeps the sum of the velocities that a law is told right, so that a law may sum them up.

    Velocities are low-passed derivatives of measured places,

        v_k = e v_k-1 + (1 - e) (p_k - p_k-1) / h,  e = exp(-cutoff h)

    so when each is flown for h, the noise in the sum of all of them is that of two places:

        h (v_a + ... + v_b-1) = P_b - P_a,  P = p - T v,  T = h / (1 - e)

    One that is flown for longer because the next step is late, or is heard twice or never, leaves its own noise behind:
    the sum is a random walk, on which a formation drifts by centimetres. What is missing is therefore told too, within
    some steps, so that none of them is a jerk:

        owed += P_b - P_a - (what was told, for as long as it was flown),  told = v_b + owed / spread

    What was held for 2 spread or longer would be made up for too much: then it starts anew.
    cutoff: rad/s of the filter;  h: s between its poses;  period: s of the law, spread = SPREAD period.
    """

    def __init__(self, cutoff: float, h: float, period: float) -> None:
        self.reach, self.spread = -h / math.expm1(-cutoff * h), SPREAD * period
        self._memory = np.full(9, math.nan)

    def start(self) -> None:
        """Nothing was told yet: there is nothing to make up for."""
        self._memory[:] = math.nan

    def told(self, flat: Vec, age: float, held: float, new: bool = True) -> Vec:
        """The state (13,) with the velocity that keeps the sum right.

        age: s, by which its place was moved on at constant velocity;  held: s that what was told last was flown;
        new: whether it was measured since then.  After a gap, or what is no number, it starts anew.
        """
        _settle(flat, age + self.reach, held, self.spread, new, self._memory)
        out = flat.copy()
        out[3:6] = self._memory[3:6]
        return out


class Hearing:
    """The states of one neighbour as a law takes them, once a step.

    In a step without a new message the newest state is moved on, p + v age. Velocities are those of `sums`.

    box: of the neighbour's states.
    """

    def __init__(self, box: Latest[State], sums: VelocitySum) -> None:
        self.box, self.sums = box, sums
        self._version = 0

    def start(self) -> None:
        """Steps begin now: there is nothing to make up for."""
        self.sums.start()

    def state(self, held: float) -> State | None:
        """The neighbour's state for this step, with the age of the message; None if that is too old.

        held: s that the last step's reference was flown.
        """
        state, age = self.box.fresh_with_age()
        new, self._version = self.box.version != self._version, self.box.version
        if state is None:
            self.start()
            return None
        flat, moved = (state.flat, state.age) if new else (moved_on(state.flat, age - state.age), age)
        return State(self.sums.told(flat, moved, held, new), age)


def moved_on(flat: Vec, age: float) -> Vec:
    """A state (13,) as it is `age` s later at constant velocity, attitude and body rates left as they were."""
    now = flat.copy()
    now[0:3] += age * now[3:6]
    return now
