"""Leaders of a formation: they stand still, or fly one path side by side.

Their followers fly accelerations.
"""

from collections.abc import Sequence
from typing import Annotated, Literal, Self

import numpy as np
from msgspec import Meta

from crazychoir.config.shared_values import share
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import SwarmTable, Text
from crazychoir.errors import ConfigError
from crazychoir.guidance.decision.team import Ids, Team, TeamLaw
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import require_feasible
from crazychoir.guidance.mission_options import (
    Duration,
    HeightOption,
    Laps,
    Length,
    Period,
    Ramp,
    own,
)
from crazychoir.guidance.path_checks import get_place_limits
from crazychoir.planning import feasibility
from crazychoir.planning.feasibility import Limits
from crazychoir.planning.figure import circle
from crazychoir.planning.trajectory import Trajectory
from crazychoir.types import FullState, Heard, Mat, Point, State, Vec

STANDING_LEADER_TIME = 20.0
"""s: duration of a law in which leaders stand still."""
Kind = Annotated[
    Literal["still", "circle", "drawn"],
    Meta(
        description='what leaders do: "still", "circle" or "drawn"', examples=["circle"]
    ),
]


class LeaderOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options] of every mission with leaders that may move."""

    leaders: Kind = "still"
    """What the leaders do."""
    radius: Length = 0.4
    """m: radius of the circle."""
    period: Period = 40.0
    """s: time of a lap of the circle."""
    laps: Laps = 1.0
    """Number of laps."""
    ramp: Ramp = 5.0
    """s: from rest to full speed."""
    drawing: Text = ""
    """A CSV file of rows stroke, t, x, y, or an SVG picture."""
    begin: Ramp = 4.0
    """s of the law before the leaders begin their path."""
    duration: Duration | None = None
    """s: duration of the law.

    None: 20 s, or until 5 s after the end of the path.
    """


class Leader(CFDistributedFeedback):
    """Stands at its place, or flies a path that begins there.

    Its references are places, while those of its followers are accelerations.

    place: (3,) m: where it hovers when the law begins.
    path: its path. None: it stands still.
    begin: s of the law before it starts the path.
    """

    def __init__(
        self, place: Point, path: Trajectory | None = None, begin: float = 0.0
    ) -> None:
        self.place = np.asarray(place, dtype=float)
        self.path = path
        self.begin = begin
        self._started: float | None = None

    def led(self, path: Trajectory) -> str:
        """Fly the path of the operator from the place where the leader should be now.

        Leaders that get the same path fly side by side.
        Returns what the leader does, in words.
        Raises ConfigError if the path cannot be flown.
        """
        if self.path is not None and self._started is not None:
            self.place = sample_shifted(self.path, self.place, self._since()).p
        require_feasible(MovedPath(path, self.place), self.member.pilot)
        self.path = path
        self.begin = 0.0
        self._started = None
        self.renew_team()
        return f"leads along it from {np.round(self.place, 2).tolist()}"

    def height(self) -> float:
        """Return the height of its place above the ground, in m."""
        return float(self.place[2]) - self.member.config.flight.ground

    @classmethod
    def for_team(cls, laws: Sequence[Self], neighbors: Sequence[Ids]) -> TeamLaw | None:
        """Return the step of leaders that all stand still; None if a leader flies a path.

        Leaders that stand still hover, as a team does without a reference.
        """
        if any(law.path is not None for law in laws):
            return None
        return stand_still

    def step(self, me: State, heard: Heard) -> FullState | None:
        """Return where the leader should be now; None if it stands still."""
        if self.path is None:
            return None
        now = self.member.clock.now()
        self._started = now if self._started is None else self._started
        return sample_shifted(self.path, self.place, self._since())

    def _since(self) -> float:
        """Return the s since the begin of the path, negative before."""
        assert self._started is not None  # noqa: S101 - callers have looked
        return self.member.clock.now() - self._started - self.begin


def stand_still(team: Team) -> None:
    """Give no leader a reference: all of them hover."""


class MovedPath:
    """A path, moved so that it begins at `place`."""

    def __init__(self, path: Trajectory, place: Vec) -> None:
        self.path = path
        self.place = place
        self.duration = path.duration

    def sample(self, t: float) -> FullState:
        """Return the reference t seconds after the start."""
        return sample_shifted(self.path, self.place, t)

    def done(self, t: float) -> bool:
        """Return whether the end is reached at t."""
        return self.path.done(t)


def sample_shifted(path: Trajectory, place: Vec, t: float) -> FullState:
    """Return the path at t, moved so that it begins at `place`.

    Before its begin and after its end the path is at rest.
    """
    flat = path.sample(min(max(t, 0.0), path.duration)).flat.copy()
    flat[0:3] += place - path.sample(0.0).p
    return FullState(flat)


def path_of(config: SwarmConfig, options: LeaderOptions) -> Trajectory | None:
    """Return the path of the leaders, or None if they stand still. Raises ConfigError."""
    match options.leaders:
        case "still":
            return None
        case "circle":
            return circle(
                (0.0, 0.0, 0.0),
                options.radius,
                options.period,
                laps=options.laps,
                ramp=options.ramp,
            )
    # Imported only where a drawing is flown, because it needs much memory.
    from crazychoir.planning.drawing.drawing import Pen, plan_drawing
    from crazychoir.planning.drawing.drawing_file import read_drawing

    if not options.drawing:
        where = f"swarm {config.name}: mission_options.drawing"
        raise ConfigError(
            where, "nothing", "a CSV file of rows stroke, t, x, y, or an SVG picture"
        )
    limits = Limits(
        v_max=0.5 * config.flight.speed_limit,
        a_max=0.25 * config.flight.acceleration_limit,
    )
    drawn = read_drawing(options.drawing)
    return plan_drawing(
        drawn.strokes, Pen(timing="drawn" if drawn.is_timed else "even"), limits
    ).path


def require_flyable(config: SwarmConfig, options: LeaderOptions) -> None:
    """Raise ConfigError for drones that hover outside the fence, and for leaders with a wrong path.

    A path is wrong if it leaves the fence or exceeds [flight].
    """
    flight = config.flight
    fence = config.fence
    room = Limits(
        v_max=flight.speed_limit,
        a_max=flight.acceleration_limit,
        low=fence.min,
        high=fence.max,
    )
    for i, place in places(config).items():
        room.check_places(place[None], f"swarm {config.name}: drone {i}: hovers")
    if path := path_of(config, options):
        t, x = feasibility.sample_references(path)
        for i, place in leaders_of(config).items():
            moved = x.copy()
            moved[:, 0:3] += place - x[0, 0:3]
            _require_within(config, i, t, moved, room)
            get_place_limits(config, i).check_places(
                moved[:, 0:3], f"swarm {config.name}: drone {i}: leads"
            )


def _require_within(config: SwarmConfig, i: int, t: Vec, x: Mat, room: Limits) -> None:
    try:
        feasibility.check_references(t, x, room)
    except ConfigError as error:
        where = (
            f"swarm {config.name}: mission_options.leaders: drone {i}: {error.where}"
        )
        raise ConfigError(where, error.found, error.allowed, error.do) from error


def height_of(config: SwarmConfig, i: int) -> float | None:
    """Return the take-off height of drone i in m above the ground.

    None: that of the swarm file.
    """
    return own(config, config.drone(i), HeightOption).height


def places(config: SwarmConfig) -> dict[int, Vec]:
    """Return where every drone hovers when the law begins.

    This is over its home, at its own `options.height` if it has one. All drones get the same
    dictionary.
    """
    return share(config, _find_places)


def _find_places(config: SwarmConfig) -> dict[int, Vec]:
    ground = config.flight.ground
    rise = config.flight.takeoff_height
    return {
        drone.id: np.array(
            [
                *drone.home[:2],
                ground + (own(config, drone, HeightOption).height or rise),
            ]
        )
        for drone in config.drones
    }


def leaders_of(config: SwarmConfig) -> dict[int, Vec]:
    """Return the leaders' places when the law begins, the same dictionary for all drones."""
    return share(config, _find_leaders)


def _find_leaders(config: SwarmConfig) -> dict[int, Vec]:
    at = places(config)
    return {drone.id: at[drone.id] for drone in config.drones if drone.leader}


def leaders_at_last(config: SwarmConfig, options: LeaderOptions) -> dict[int, Vec]:
    """Return the leaders' places when the law ends."""
    path = path_of(config, options)
    leaders = leaders_of(config)
    if path is None:
        return leaders
    t = duration_of(config, options) - options.begin
    return {i: sample_shifted(path, place, t).p for i, place in leaders.items()}


def leader_of(i: int, config: SwarmConfig, options: LeaderOptions) -> Leader:
    """Return the law of leader i."""
    leader = Leader(leaders_of(config)[i], path_of(config, options), options.begin)
    leader.duration = duration_of(config, options)
    return leader


def duration_of(config: SwarmConfig, options: LeaderOptions) -> float:
    """Return the duration of the law in s."""
    if options.duration is not None:
        return options.duration
    path = path_of(config, options)
    return STANDING_LEADER_TIME if path is None else options.begin + path.duration + 5.0
