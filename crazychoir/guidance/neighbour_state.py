"""The states that a law receives: its own and its neighbours'.

They are corrected for late, lost and repeated messages. Each object here is the form for one drone
or one neighbour of the rows in decision/.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.guidance.decision.flight_rows import ELSEWHERE_SOURCE, FRAMES_SOURCE
from crazychoir.guidance.decision.hearing_rows import (
    HEARING_ROW,
    put_first_row,
    take_rows,
)
from crazychoir.guidance.decision.velocity_sums import (
    CORRECTION_STEPS,
    VELOCITY_SUM_ROW,
    correct_first_row,
)
from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.runtime.mailbox import Mailbox
from crazychoir.types import State

Rows = npt.NDArray[Any]
"""An array of records."""


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
        self.rows = np.zeros(1, VELOCITY_SUM_ROW)
        """(1,) of VELOCITY_SUM_ROW."""
        self.rows["h"] = h
        self.rows["reach"] = -h / math.expm1(-cutoff * h)
        self.rows["spread"] = CORRECTION_STEPS * period
        self.rows["is_even"] = 1

    def told(self, state: State, age: float, held: int, steps: int) -> State:
        """Return the state with this age, and with the velocity that keeps the sum right.

        state: extrapolated from the measurement by its own age, at constant velocity.
        age: s: age of the returned state.
        held: number of poses for which the state before was flown.
        steps: number of poses from the measurement before to this one; 0: the same measurement.
        """
        told = np.empty(13)
        if correct_first_row(self.rows, state.flat, state.age, held, steps, told):
            return State(told, age, state.a)
        return state if age == state.age else State(state.flat, age, state.a)


class HearingMailbox(Mailbox[State]):
    """The mailbox for the states of one neighbour: it holds the newest one.

    rows: (1,) of HEARING_ROW, with the settings of the mailbox. All of its numbers are there.
    """

    def __init__(self, clock: Clock, name: str, rows: Rows) -> None:
        self.rows = rows
        super().__init__(clock, name)

    @property
    def received(self) -> int:
        """States that have arrived."""
        return int(self.rows["received"][0])

    @received.setter
    def received(self, count: int) -> None:
        self.rows["received"] = count

    @property
    def dropped(self) -> int:
        """States that were replaced unread, or came after a newer one."""
        return int(self.rows["dropped"][0])

    @dropped.setter
    def dropped(self, count: int) -> None:
        self.rows["dropped"] = count

    @property
    def stale(self) -> int:
        """Reads that found only a state that was too old."""
        return int(self.rows["stale"][0])

    @stale.setter
    def stale(self, count: int) -> None:
        self.rows["stale"] = count

    def take_from(self, place: int, rate: float) -> None:
        """Take the states of a drone in the same batch, without messages.

        place: of the drone in the batch, or FRAMES_SOURCE
        rate: Hz, of the states; 0 for each state
        """
        self.rows["source"] = place
        self.rows["interval_ns"] = round(NS_PER_SECOND / rate) if rate > 0.0 else 0

    def take_from_frames(self, place: int, rate: float) -> None:
        """Take the states of a drone of another process from the frames of the airspace.

        place: row of the drone in the swarm of the airspace
        rate: as in `take_from`
        """
        self.take_from(FRAMES_SOURCE, rate)
        self.rows["frame_place"] = place

    def move_to(self, rows: Rows) -> None:
        """Go on with these rows (1,) of HEARING_ROW: all numbers move there."""
        rows[:] = self.rows
        self.rows = rows

    def put(self, value: State, age: float = 0.0) -> None:
        """Replace the content, unless it is newer; drop what has not the numbers of a state."""
        now_ns = self.clock.now_ns()
        try:
            is_state = put_first_row(
                self.rows, value.flat, value.a, value.age, age, now_ns
            )
        except TypeError:  # arrays of another type or layout
            is_state = self._put_converted(value, age, now_ns)
        if not is_state:
            self.received += 1
            self.dropped += 1

    def _put_converted(self, value: State, age: float, now_ns: int) -> bool:
        """Put a state with arrays that kernels do not take; return whether it is a state."""
        try:
            flat = np.array(value.flat, dtype=np.float64)
            acceleration = np.array(value.a, dtype=np.float64)
            put = put_first_row(
                self.rows, flat, acceleration, float(value.age), age, now_ns
            )
        except (TypeError, ValueError):
            return False
        return bool(put)

    def clear(self) -> None:
        """Return to the state before the first message."""
        for name in ("version", "seen_version", "told_version"):
            self.rows[name] = 0

    def is_fresh(self) -> bool:
        """Return whether the newest state is not too old."""
        row = self.rows[0]
        age_ns = self.clock.now_ns() - int(row["born_ns"])
        return bool(row["version"] > 0 and age_ns <= row["max_ns"])

    def state(self, now_ns: int, held: int) -> State | None:
        """Return the state of the neighbour for this step, with the age of the message.

        None if the message is too old.

        now_ns: ns: the present time.
        held: number of poses for which the reference of the last step was flown.
        """
        take_rows(self.rows, now_ns, held)
        row = self.rows[0]
        if row["is_heard"] == 0:
            return None
        return State(
            row["told"].copy(), float(row["told_age"]), row["told_acceleration"].copy()
        )


class StateMailbox(HearingMailbox):
    """The mailbox for the states of one neighbour. A law takes a state from it once a step.

    In a step without a new message the newest state is extrapolated, p + v age. Velocities are
    those of a VelocitySum.

    sums: the VelocitySum, with its settings
    rows: (1,) of HEARING_ROW, None: its own
    """

    def __init__(
        self, clock: Clock, name: str, sums: VelocitySum, rows: Rows | None = None
    ) -> None:
        rows = _prepare_rows(rows, float(sums.rows["h"][0]))
        rows["sum"] = sums.rows
        super().__init__(clock, name, rows)


class PairedStateMailbox(HearingMailbox):
    """The mailbox for the states of one neighbour, for a law that uses its acceleration.

    Message m holds the acceleration that was commanded in the tick of message m - 1. Position and
    velocity are therefore those of that tick. If n - 1 messages before m were lost, they are
    interpolated from the last message that arrived:

        x = x_m + (x_m-n - x_m) / n,   a = a_m

    In a step without a new message it returns the last state again, with a larger age, and does
    not extrapolate it: laws use the sum a + kv v + kp p, which changes less than p alone. The first
    state is returned unchanged.

    h: s between two states.
    rows: (1,) of HEARING_ROW, None: its own
    """

    def __init__(
        self, clock: Clock, name: str, h: float, rows: Rows | None = None
    ) -> None:
        rows = _prepare_rows(rows, h)
        rows["is_paired"] = 1
        super().__init__(clock, name, rows)


def _prepare_rows(rows: Rows | None, h: float) -> Rows:
    """Return an empty row for states that come every h s.

    rows: (1,) of HEARING_ROW, or None for a new one
    """
    if rows is None:
        rows = np.zeros(1, HEARING_ROW)
    rows["source"] = ELSEWHERE_SOURCE
    rows["h_ns"] = round(h * NS_PER_SECOND)
    rows["max_ns"] = round(DRONE_TOPICS.state.max_age * NS_PER_SECOND)
    rows["sum"]["is_even"] = 1
    return rows
