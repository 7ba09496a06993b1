"""The laws of one class in this process as a team: what all of them receive, in arrays.

A class that gives `for_team` beside `step` takes one step for all of its drones here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
import numpy.typing as npt

from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.law_rows import (
    LAW_ROW,
    STEP_DECISION,
    LawDecision,
    ReferenceKind,
)
from crazychoir.runtime.clock import Clock
from crazychoir.types import (
    Acceleration,
    Bools,
    FullState,
    Heard,
    Ints,
    Mat,
    Reference,
    State,
    Velocity,
)

Rows = npt.NDArray[Any]
"""An array of records."""
# Members of an enumeration are slow to look up and to compare.
HOVER_KIND = int(ReferenceKind.HOVER)
ACCELERATION_KIND = int(ReferenceKind.ACCELERATION)
VELOCITY_KIND = int(ReferenceKind.VELOCITY)
FULL_STATE_KIND = int(ReferenceKind.FULL_STATE)

Ids = tuple[int, ...]
"""Ids of the neighbours of a drone."""


@dataclass(slots=True)
class Team:
    """What a step of a team receives, and where its references go.

    Every law has a row. The references of laws that do not step in this tick are not used.
    """

    rows: Rows
    """(n,) of LAW_ROW: the drones."""
    edges: Rows
    """(e,) of HEARING_ROW: their neighbours, those of the first drone first."""
    now_ns: int = 0
    """ns: the present time."""
    epoch_ns: int = 0
    """ns: what the team's time is ahead of the present time."""

    @property
    def states(self) -> Mat:
        """(n, 13): the drones' own states."""
        return self.rows["state"]

    @property
    def heard_states(self) -> Mat:
        """(e, 13): the states of the neighbours; not up to date where `is_heard` is False."""
        return self.edges["told"]

    @property
    def heard_accelerations(self) -> Mat:
        """(e, 3) m/s2: the accelerations of the neighbours."""
        return self.edges["told_acceleration"]

    @property
    def is_heard(self) -> Bools:
        """(e,): whether the neighbour is heard."""
        found: Bools = self.edges["is_heard"] == 1
        return found

    @property
    def steps(self) -> Ints:
        """Rows of the laws that step in this tick."""
        found: Ints = (self.rows["decision"] == STEP_DECISION).nonzero()[0]
        return found

    @property
    def receivers(self) -> Ints:
        """(e,): row of the drone that hears along each edge."""
        counts = self.rows["end_edge"] - self.rows["first_edge"]
        return np.repeat(np.arange(len(self.rows)), counts)

    @property
    def step_numbers(self) -> Ints:
        """(n,): steps that each law has taken before this one."""
        return self.rows["tally"]["steps"]

    def accelerate(self, accelerations: Mat, where: Bools | None = None) -> None:
        """Give each drone an Acceleration.

        accelerations: (n, 3) m/s2.
        where: (n,): True for the drones that get it; the others hover. None: all.
        """
        self.rows["reference"][:, 6:9] = accelerations
        self.rows["reference"][:, 12] = 0.0
        chosen: Any = True if where is None else where
        self.rows["kind"] = np.where(
            chosen, ReferenceKind.ACCELERATION, ReferenceKind.HOVER
        )

    def follow(self, places: Mat, velocities: Mat) -> None:
        """Give each drone a FullState without acceleration and yaw.

        places: (n, 3) m, world.
        velocities: (n, 3) m/s, world.
        """
        self.rows["reference"][:, 0:3] = places
        self.rows["reference"][:, 3:6] = velocities
        self.rows["reference"][:, 6:14] = 0.0
        self.rows["kind"] = ReferenceKind.FULL_STATE


TeamLaw = Callable[[Team], None]
"""One step of a team: writes `kind` and `reference` of the rows. A row without them hovers."""


class LawOfTeam(Protocol):
    """A law with a step for a team."""

    @classmethod
    def for_team(
        cls, laws: "Sequence[Self]", neighbors: Sequence[Ids]
    ) -> TeamLaw | None:
        """Return the step of all these laws at once; see CFDistributedFeedback."""
        ...


def has_team_law(kind: type) -> bool:
    """Return whether `for_team` of a class gives the step of that class.

    It does not if a class below the one with `for_team` has a `step` of its own.
    """
    for base in kind.__mro__:
        if "for_team" in vars(base):
            return True
        if "step" in vars(base):
            return False
    return False


def step_alone(
    law: LawOfTeam, me: State, heard: Heard, clock: Clock | None = None
) -> Reference | None:
    """Return the reference of one law, by the step of its team. Counts its steps since it was made.

    me: the drone's own state.
    heard: {j: state of neighbour j}.
    clock: for laws that use the time.
    """
    ids = tuple(sorted(heard))
    known, team, team_law = law.__dict__.get("_alone", (None, None, None))
    if known != ids or team is None:
        taken = 0 if team is None else team.step_numbers
        team_law = type(law).for_team([law], [ids])
        team = _build_lone_team(len(ids))
        team.rows["tally"]["steps"] = taken
        law.__dict__["_alone"] = (ids, team, team_law)
    row = team.rows[0]
    row["state"] = me.flat
    row["acceleration"] = me.a
    row["age"] = me.age
    row["kind"] = ReferenceKind.HOVER
    for edge, j in zip(team.edges, ids, strict=True):
        edge["told"] = heard[j].flat
        edge["told_acceleration"] = heard[j].a
        edge["told_age"] = heard[j].age
    if clock is not None:
        team.now_ns = clock.now_ns()
        team.epoch_ns = clock.epoch_ns
    team_law(team)
    row["tally"]["steps"] += 1
    return read_references(team.rows)[0]


def _build_lone_team(count: int) -> Team:
    """Return a team of one drone that hears so many neighbours."""
    rows = np.zeros(1, LAW_ROW)
    rows["end_edge"] = count
    rows["decision"] = LawDecision.STEP
    edges = np.zeros(count, HEARING_ROW)
    edges["is_heard"] = 1
    return Team(rows, edges)


def read_references(rows: Rows) -> list[Reference | None]:
    """Return the references in rows (n,) of LAW_ROW; None: the drone hovers."""
    kinds = rows["kind"].tolist()
    numbers = rows["reference"].copy()
    yaws = numbers[:, 12].tolist()
    found: list[Reference | None] = []
    for kind, flat, yaw in zip(kinds, numbers, yaws, strict=True):
        if kind == HOVER_KIND:
            found.append(None)
        elif kind == ACCELERATION_KIND:
            found.append(Acceleration(flat[6:9], yaw))
        elif kind == VELOCITY_KIND:
            found.append(Velocity(flat[3:6], yaw))
        else:
            found.append(FullState(flat))
    return found
