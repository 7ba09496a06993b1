"""What a law is told of its own state and of its neighbours', such that late, lost and repeated ones leave no trace."""

import math

import numpy as np

from crazychoir.bus.topics import STATE
from crazychoir.numerics.kernels import kernel, memory, real, vector
from crazychoir.runtime.clock import SECOND, Clock
from crazychoir.runtime.mailbox import Latest
from crazychoir.types import STILL, State, Vec

SPREAD = 10.0  # steps within which a law is told what the velocities so far have lacked
NOTHING = 1e-7  # m; less is not owed


@kernel(vector, real, vector, real, real, real, real, memory, memory)
def _settle(
    x: Vec,
    reach: float,
    last: Vec,
    last_reach: float,
    held: float,
    spread: float,
    new: float,
    mem: Vec,
    out: Vec,
) -> float:
    """The law of VelocitySum from the state `last` to x, into out (13,); returns the largest part that is owed, m.

    mem: (6,) = velocity that was told, owed m.
    """
    most = 0.0
    out[:] = x
    for c in range(3):
        owed = mem[3 + c] - held * mem[c]
        if new > 0.0:
            owed += (x[c] - reach * x[3 + c]) - (last[c] - last_reach * last[3 + c])
            owed = owed if held < 2.0 * spread and math.isfinite(owed) else 0.0
            out[3 + c] += owed / spread
        mem[c] = out[3 + c]
        mem[3 + c] = owed
        most = max(most, abs(owed))
    return most


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
        self.h = h
        self.reach = -h / math.expm1(-cutoff * h)
        self.spread = SPREAD * period
        self.even = True
        """Nothing is owed: while each state is told for h, the next may be told as it is; `last` is to know it."""
        self.last: State | None = None
        """What was told last, before its velocity was corrected."""
        self._memory = np.zeros(6)

    def forget(self) -> None:
        """As before the first state: nothing was told, there is nothing to make up for."""
        self.last = None
        self.even = True

    def told(self, state: State, age: float, held: int, steps: int) -> State:
        """The state with the velocity that keeps the sum right, and this age.

        state: its place was moved on from the measurement by its own age, at constant velocity;  held: poses for which
        what was told last was flown;  steps: poses from the measurement before to this one, 0: it is the same.
        """
        last = self.last
        if (held == 1 and steps == 1 and self.even) or last is None:
            self.last = state
            return state if age == state.age else State(state.flat, age, state.a)
        memory = self._memory
        out = np.empty(13)
        if self.even:
            memory[0:3] = last.v
            memory[3:6] = 0.0
        before = self.reach + last.age
        now = self.reach + state.age
        new = float(steps > 0)
        owed = _settle(
            state.flat,
            now,
            last.flat,
            before,
            held * self.h,
            self.spread,
            new,
            memory,
            out,
        )
        self.even = owed < NOTHING
        if steps > 0:
            self.last = state
        return State(out, age, state.a)


class Hearing(Latest[State]):
    """The mailbox for the states of one neighbour, as a law takes them, once a step.

    In a step without a new message the newest state is moved on, p + v age. Velocities are those of a VelocitySum.
    """

    def __init__(self, clock: Clock, name: str, sums: VelocitySum) -> None:
        super().__init__(clock, name, STATE.max_age)
        self.sums = sums
        self._h_ns = round(sums.h * SECOND)
        self._max_ns = round(STATE.max_age * SECOND)
        self._half_ns = self._h_ns // 2
        self._told_version = self._told_ns = 0

    def forget(self) -> None:
        """Steps begin now: there is nothing to make up for."""
        self.sums.forget()

    def state(self, now_ns: int, held: int) -> State | None:
        """The neighbour's state for this step, with the age of the message; None if that is too old.

        held: poses for which the last step's reference was flown.
        """
        born_ns = self._born_ns
        sums = self.sums
        state = self._value
        if now_ns - born_ns > self._max_ns or state is None:
            self.stale += state is not None
            sums.forget()
            return None
        age = (now_ns - born_ns) / SECOND
        version = self.version
        steps = (born_ns - self._told_ns + self._half_ns) // self._h_ns
        self._told_ns = born_ns
        self._seen = version
        if (
            steps == 1 == held and sums.even
        ):  # as a rule: all is as the filter adds it up
            self._told_version = version
            sums.last = state
            return state if age == state.age else State(state.flat, age, state.a)
        if version == self._told_version:
            state = State(moved_on(state.flat, age - state.age), age, state.a)
        self._told_version = version
        return sums.told(state, age, held, steps)


class Paired(Latest[State]):
    """The mailbox for the states of one neighbour, for a law that adds up what its neighbours command.

    Place and velocity are those of the tick in which the acceleration was commanded, that is of message m - 1; where
    n - 1 messages before m were lost, of the way from the last that came:

        x = x_m + (x_m-n - x_m) / n,   a = a_m

    In a step without a new message it tells the same again, older: a + kv v + kp p says where a drone is on its way to,
    which changes less than where it is. The first is told as it is.  h: s between two states.
    """

    def __init__(self, clock: Clock, name: str, h: float) -> None:
        super().__init__(clock, name, STATE.max_age)
        self._h_ns = round(h * SECOND)
        self._max_ns = round(STATE.max_age * SECOND)
        self._told_version = self._told_ns = 0
        self._last: State | None = None
        self._flat = STILL

    def forget(self) -> None:
        """Steps begin now."""
        self._last = None

    def state(self, now_ns: int, held: int) -> State | None:
        """The neighbour's state for this step, with the age of the message; None if that is too old."""
        born_ns = self._born_ns
        state = self._value
        last = self._last
        if now_ns - born_ns > self._max_ns or state is None:
            self.stale += state is not None
            self._last = None
            return None
        self._seen = self.version
        if self._told_version != self.version or last is None:
            steps = round((born_ns - self._told_ns) / self._h_ns)
            if last is None or steps < 1:
                self._flat = state.flat
            else:
                self._flat = between(state.flat, last.flat, 1.0 / steps)
            self._told_version = self.version
            self._told_ns = born_ns
            self._last = state
        return State(self._flat, (now_ns - born_ns) / SECOND, state.a)


def between(flat: Vec, before: Vec, share: float) -> Vec:
    """A state (13,) with the place and velocity of this share of the way back to the one before."""
    now = flat.copy()
    now[0:6] += share * (before[0:6] - now[0:6])
    return now


def moved_on(flat: Vec, seconds: float) -> Vec:
    """A state (13,) as it is some seconds later at constant velocity, attitude and body rates left as they were."""
    now = flat.copy()
    now[0:3] += seconds * now[3:6]
    return now
