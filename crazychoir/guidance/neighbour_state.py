"""The states that a law receives: its own and its neighbours'.

They are corrected for late, lost and repeated messages.
"""

import math

import numpy as np

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.numerics.kernels import kernel, memory, real, vector
from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.runtime.mailbox import Latest
from crazychoir.types import ZERO_ACCELERATION, State, Vec

CORRECTION_STEPS = 10.0  # steps in which a missing amount of velocity is made up
NEGLIGIBLE_AMOUNT = 1e-7  # m: smaller amounts are not made up


@kernel(vector, real, vector, real, real, real, real, memory, memory)
def _correct_velocity(
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
    """Correct the velocity of state x by the law of VelocitySum, into out.

    Returns the largest component of the amount that is still owed, in m.

    x: (13,): the new state.
    reach: s: T of VelocitySum, plus the age of x.
    last: (13,): the state before.
    last_reach: s: the same for `last`.
    held: s for which the velocity before was flown.
    spread: s in which an owed amount is made up.
    new: above 0 if x is a new measurement.
    mem: (6,) = the velocity that the law received last, m/s; the owed amount, m. Both are updated.
    out: (13,): x with the corrected velocity.
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
    """Corrects the velocities that a law receives, so that a law may sum them up.

    Velocities are low-passed derivatives of measured positions,

        v_k = e v_k-1 + (1 - e) (p_k - p_k-1) / h,   e = exp(-cutoff h)

    If each velocity is flown for h, the noise in their sum is the noise of two positions only:

        h (v_a + ... + v_b-1) = P_b - P_a,   P = p - T v,   T = h / (1 - e)

    A velocity that is flown for longer because the next step is late, or that is received twice or
    never, leaves its own noise in the sum. The sum is then a random walk, on which a formation
    drifts by centimetres. The law therefore also receives the missing amount, spread over some
    steps to avoid jerks:

        owed += P_b - P_a - (sum of each received velocity times the time for which it was flown)
        received = v_b + owed / spread

    After a hold of 2 spread or longer the correction would be too large. Then it starts anew.

    P, T: corrected position m, and its delay s; a, b: two steps; owed: m.

    cutoff: rad/s of the filter.
    h: s between two poses of the filter.
    period: s between two steps of the law; spread = CORRECTION_STEPS period.
    """

    def __init__(self, cutoff: float, h: float, period: float) -> None:
        self.h = h
        self.reach = -h / math.expm1(-cutoff * h)
        self.spread = CORRECTION_STEPS * period
        self.even = True
        """No amount is owed.

        The next state then needs no correction, if the one before was used for exactly h.
        """
        self.last: State | None = None
        """The state that the law received last, before its velocity was corrected."""
        self._memory = np.zeros(6)

    def forget(self) -> None:
        """Forget the last state and the owed amount."""
        self.last = None
        self.even = True

    def told(self, state: State, age: float, held: int, steps: int) -> State:
        """Return the state with this age, and with the velocity that keeps the sum right.

        state: extrapolated from the measurement by its own age, at constant velocity.
        age: s: age of the returned state.
        held: number of poses for which the state before was flown.
        steps: number of poses from the measurement before to this one; 0: the same measurement.
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
        owed = _correct_velocity(
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
        self.even = owed < NEGLIGIBLE_AMOUNT
        if steps > 0:
            self.last = state
        return State(out, age, state.a)


class StateMailbox(Latest[State]):
    """The mailbox for the states of one neighbour. A law takes a state from it once a step.

    In a step without a new message the newest state is extrapolated, p + v age. Velocities are
    those of a VelocitySum.
    """

    def __init__(self, clock: Clock, name: str, sums: VelocitySum) -> None:
        super().__init__(clock, name, DRONE_TOPICS.state.max_age)
        self.sums = sums
        self._h_ns = round(sums.h * NS_PER_SECOND)
        self._max_ns = round(DRONE_TOPICS.state.max_age * NS_PER_SECOND)
        self._half_ns = self._h_ns // 2
        self._told_version = self._told_ns = 0

    def forget(self) -> None:
        """Forget the last state and the owed amount, because the law starts now."""
        self.sums.forget()

    def state(self, now_ns: int, held: int) -> State | None:
        """Return the state of the neighbour for this step, with the age of the message.

        None if the message is too old.

        now_ns: ns: the present time.
        held: number of poses for which the reference of the last step was flown.
        """
        born_ns = self._born_ns
        sums = self.sums
        state = self._value
        if now_ns - born_ns > self._max_ns or state is None:
            self.stale += state is not None
            sums.forget()
            return None
        age = (now_ns - born_ns) / NS_PER_SECOND
        version = self.version
        steps = (born_ns - self._told_ns + self._half_ns) // self._h_ns
        self._told_ns = born_ns
        self._seen = version
        if (
            steps == 1 == held and sums.even
        ):  # usual case: no message is late or missing
            self._told_version = version
            sums.last = state
            return state if age == state.age else State(state.flat, age, state.a)
        if version == self._told_version:
            state = State(extrapolate_state(state.flat, age - state.age), age, state.a)
        self._told_version = version
        return sums.told(state, age, held, steps)


class PairedStateMailbox(Latest[State]):
    """The mailbox for the states of one neighbour, for a law that uses its acceleration.

    Message m holds the acceleration that was commanded in the tick of message m - 1. Position and
    velocity are therefore those of that tick. If n - 1 messages before m were lost, they are
    interpolated from the last message that arrived:

        x = x_m + (x_m-n - x_m) / n,   a = a_m

    In a step without a new message it returns the last state again, with a larger age, and does
    not extrapolate it: laws use the sum a + kv v + kp p, which changes less than p alone. The first
    state is returned unchanged.

    h: s between two states.
    """

    def __init__(self, clock: Clock, name: str, h: float) -> None:
        super().__init__(clock, name, DRONE_TOPICS.state.max_age)
        self._h_ns = round(h * NS_PER_SECOND)
        self._max_ns = round(DRONE_TOPICS.state.max_age * NS_PER_SECOND)
        self._told_version = self._told_ns = 0
        self._last: State | None = None
        self._flat = ZERO_ACCELERATION

    def forget(self) -> None:
        """Forget the last state: the next one is returned unchanged, without interpolation."""
        self._last = None

    def state(self, now_ns: int, held: int) -> State | None:
        """Return the state of the neighbour for this step, with the age of the message.

        None if the message is too old.
        """
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
                self._flat = interpolate_state(state.flat, last.flat, 1.0 / steps)
            self._told_version = self.version
            self._told_ns = born_ns
            self._last = state
        return State(self._flat, (now_ns - born_ns) / NS_PER_SECOND, state.a)


def interpolate_state(flat: Vec, before: Vec, share: float) -> Vec:
    """Return a state (13,) with p and v moved by this share of the way back to the state before."""
    now = flat.copy()
    now[0:6] += share * (before[0:6] - now[0:6])
    return now


def extrapolate_state(flat: Vec, seconds: float) -> Vec:
    """Return a state (13,) extrapolated by some seconds at constant velocity.

    Attitude and body rates stay the same.
    """
    now = flat.copy()
    now[0:3] += seconds * now[3:6]
    return now
