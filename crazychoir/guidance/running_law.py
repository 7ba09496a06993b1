"""One drone's law in the decide stage: its rows, and what becomes of its steps."""

import asyncio
import contextlib
import logging
from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np

from crazychoir.flight.references import convert_reference, explain_refusal
from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.law_rows import (
    LAW_ROW,
    LawDecision,
    start_row,
)
from crazychoir.guidance.decision.team import (
    ACCELERATION_KIND,
    FULL_STATE_KIND,
    VELOCITY_KIND,
    has_team_law,
)
from crazychoir.guidance.law_tally import LawTally, explain_wrong_return
from crazychoir.guidance.member import (
    Interrupted,
    Member,
    describe_state,
    make_raisable,
)
from crazychoir.guidance.neighbour_state import (
    HearingMailbox,
    PairedStateMailbox,
    Rows,
    StateMailbox,
    VelocitySum,
)
from crazychoir.guidance.user_hook import locate_function
from crazychoir.runtime.clock import NS_PER_SECOND, wake_waiter
from crazychoir.types import (
    Acceleration,
    FullState,
    Heard,
    Ints,
    Reference,
    State,
    Vec,
    Velocity,
)

log = logging.getLogger(__name__)
FLOAT64_TYPE = np.dtype(np.float64)


class SteppingLaw(Protocol):
    """The part of a law that steps."""

    rate: float
    """Hz."""
    paired: bool
    """Whether states come as Paired delivers them."""

    def step(self, me: State, heard: Heard) -> Reference | None:
        """Return the reference to fly until the next step."""


class RunningLaw:
    """The law of one drone while it flies: its rows in the decide stage, and its end.

    law: the law
    member: the drone
    ids: its neighbours
    """

    def __init__(self, law: SteppingLaw, member: Member, ids: tuple[int, ...]) -> None:
        self.law = law
        self.drone = member.id
        self.ids = ids
        self._actor = f"drone {self.drone} guidance"
        self._use(np.zeros(1, LAW_ROW))
        self.edges: Rows = np.zeros(len(ids), HEARING_ROW)
        self.hearings = [
            self._hearing(member, j, self.edges[e : e + 1]) for e, j in enumerate(ids)
        ]
        self.rows["drone"] = member.id
        self.rows["place"] = member.pilot.row.index
        self.rows["is_paired"] = law.paired
        self.rows["end_edge"] = len(ids)
        self.rows["sum"] = self._sum(member).rows
        self.tally = LawTally(member.id, self.rows["tally"])
        self._member = member
        self._end: asyncio.Future[None] | None = None

    def _hearing(self, member: Member, j: int, rows: Rows) -> HearingMailbox:
        name = f"drone {self.drone} state of {j}"
        if self.law.paired:
            h = 1.0 / member.config.mocap.rate
            return PairedStateMailbox(member.clock, name, h, rows)
        return StateMailbox(member.clock, name, self._sum(member), rows)

    def _sum(self, member: Member) -> VelocitySum:
        return VelocitySum(
            member.pilot.stages.filter.cutoff,
            1.0 / member.config.mocap.rate,
            1.0 / self.law.rate,
        )

    @property
    def unheard(self) -> dict[int, int]:
        """{j: steps in which neighbour j was not heard}."""
        return dict(zip(self.ids, self.edges["unheard"].tolist(), strict=True))

    def _use(self, rows: Rows) -> None:
        """Step with this row: (1,) of LAW_ROW."""
        self.rows: Rows = rows
        self._kinds: Ints = rows["kind"]
        # Views of the parts of the reference, because making a view takes long.
        self._reference: Vec = rows["reference"][0]
        self._velocity: Vec = self._reference[3:6]
        self._acceleration: Vec = self._reference[6:9]

    def move_to(self, rows: Rows, edges: Rows) -> None:
        """Go on with these rows: (1,) of LAW_ROW and (k,) of HEARING_ROW."""
        rows[:] = self.rows
        self._use(rows)
        for e, hearing in enumerate(self.hearings):
            hearing.move_to(edges[e : e + 1])
        self.edges = edges
        self.tally.rows = rows["tally"]

    def find_heard_ns(self, j: int) -> int | None:
        """Return when the newest state of a neighbour was measured, ns; None: none has come."""
        if j not in self.ids:
            return None
        row = self.edges[self.ids.index(j)]
        return int(row["born_ns"]) if row["version"] > 0 else None

    def list_told(self) -> list[int]:
        """Return the neighbours in this process that the law hears in each tick."""
        edges = self.edges
        is_told = (edges["source"] >= 0) & (edges["interval_ns"] == 0)
        return [j for j, told in zip(self.ids, is_told.tolist(), strict=True) if told]

    def start(self, now_ns: int) -> asyncio.Future[None]:
        """Let the law step from now on; return the future of its end.

        now_ns: ns: the present time
        """
        self.rows["period_ns"] = round(NS_PER_SECOND / self.law.rate)
        self.rows["early_ns"] = -(-self._member.pilot.setup.period_ns // 2)
        start_row(self.rows, self.edges, now_ns)
        self._end = asyncio.get_running_loop().create_future()
        return self._end

    def end(self) -> None:
        """End the law: its time is over."""
        self.rows["is_running"] = 0
        if self._end is not None:
            wake_waiter(self._end)

    def guard(self) -> AbstractContextManager[object]:
        """Return a context in which a step that does not return is interrupted."""
        watchdog = self._member.watchdog
        if watchdog is None:
            return contextlib.nullcontext()
        return watchdog.guard(self._actor)

    def step(self, me: State, heard: Heard) -> None:
        """Take one step by hand: call `step` of the law and fly its reference.

        Its errors end the law. They do not end the tick, because the tick belongs to other drones
        too.
        """
        watchdog = self._member.watchdog
        try:
            if watchdog is None:
                reference = self.law.step(me, heard)
            else:
                with watchdog.guard(self._actor):
                    reference = self.law.step(me, heard)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - run_law raises it
            self.rows["decision"] = LawDecision.REST
            self.fail(error)
            return
        if not self._write(reference):
            self.rows["decision"] = LawDecision.REST
            self.tally.count(reference)
            self.fly(reference)

    def _write(self, reference: Any) -> bool:
        """Write a usual reference into the row; return False for others, which the pilot takes.

        The row has the reference None already, and zeros in `reference`.
        """
        # Comparing types costs a fifth of matching patterns.
        kind = type(reference)
        if kind is Acceleration:
            number = ACCELERATION_KIND
            values = reference.a
            target = self._acceleration
        elif kind is Velocity:
            number = VELOCITY_KIND
            values = reference.v
            target = self._velocity
        elif kind is FullState:
            number = FULL_STATE_KIND
            values = reference.flat
            target = self._reference
        else:
            return reference is None
        if (
            type(values) is not np.ndarray
            or values.shape != target.shape
            or values.dtype != FLOAT64_TYPE
        ):
            return False
        if kind is not FullState:
            if not isinstance(reference.yaw, float):
                return False
            self._reference[12] = reference.yaw
        self._kinds[0] = number
        target[:] = values
        return True

    def fly(self, reference: Reference | None) -> None:
        """Fly a reference of a step; None: hover."""
        pilot = self._member.pilot
        try:
            if reference is None:
                pilot.hover()
            elif not pilot.follow(reference):
                self._refuse(reference)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - run_law raises it
            self.fail(error)

    def stop(self) -> None:
        """End the law, because the pilot does something else."""
        reason = f"drone {self.drone}: {describe_state(self._member.pilot)}"
        if self.tally.refused and self.tally.steps <= self.tally.refused_step + 1:
            reason = f"{self.tally.explain_refusals()}; {reason}"
        self.fail(Interrupted(f"{reason}{self._name_silent()}"))

    def fail(self, error: BaseException) -> bool:
        """End the law with an error; return False if it has ended before."""
        self.rows["is_running"] = 0
        if self._end is None or self._end.done():
            return False
        self._end.set_exception(make_raisable(error, f"drone {self.drone}: step"))
        return True

    def _refuse(self, reference: object) -> None:
        """Count a reference that can never be flown, and log the reason once."""
        if convert_reference(reference) is None:
            why = f"{explain_wrong_return(reference)}; {explain_refusal(reference)}"
        else:
            why = self._member.pilot.follower.explain_unflown(reference)
        kind: Any = type(self.law)
        step = kind.for_team if has_team_law(kind) else self.law.step
        why = f"{why} ({locate_function(step)})"
        self.tally.refuse(why)
        if self.tally.refused == 1:
            log.warning("drone %d: %s: not flown", self.drone, why)

    def _name_silent(self) -> str:
        """Return the silent neighbours in words, or "".

        Missing neighbours are the usual reason for a law that gives no reference.
        """
        found = zip(self.ids, self.hearings, strict=True)
        silent = ", ".join(str(j) for j, hearing in found if not hearing.is_fresh())
        return f"; hears nothing of drone(s) {silent}" if silent else ""
