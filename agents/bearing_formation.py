"""Bearing formation: followers find their places from the bearings to their neighbours alone.

Leaders stand still or fly a path.

crazychoir run bearing_formation --fast                 # four in a square
crazychoir run bearing_formation --fast --drones 30     # a grid
crazychoir run bearing_formation --fast --drones 11     # a letter S
crazychoir run deploy/formation_circle.toml --fast      # leaders on a circle
crazychoir run deploy/formation_drawn.toml --fast       # leaders on a hand-drawn path
"""

from collections.abc import Iterable
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from msgspec import Meta

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.tables import Share
from crazychoir.control.gains import (
    AGILE_GAINS,
    FORMATION_GAINS,
    FORMATION_GAINS_ON_MOTORS,
    Gains,
)
from crazychoir.errors import ConfigError
from crazychoir.guidance.formation import bearing, leader, shapes
from crazychoir.guidance.formation.bearing import Law, check_formation
from crazychoir.guidance.formation.leader import LeaderOptions
from crazychoir.guidance.formation.modes import AccelerationChain
from crazychoir.guidance.formation.scattering import Scatter, scatter_swarm
from crazychoir.guidance.formation.shapes import Shape
from crazychoir.guidance.mission_options import (
    Gain,
    Length,
    Places,
    Spreads,
    given,
    require_each,
)
from crazychoir.numerics.math3d import projector
from crazychoir.platforms import find_platform
from crazychoir.recording.analysis.tracks import draw_tracks
from crazychoir.types import Acceleration, Heard, State, Vec

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
HOVER_BEFORE_LAW = 4.0
"""s: hovering before the paper's law.

The slow modes of that law turn a trim error of mm/s2 into centimetres.
"""
BRISK_COLLISION: dict[str, Any] = {"brake": 2.0, "stiff": 5.0}
"""[collision] of drones that accelerate with 4 m/s2.

With the defaults, drones that pass each other wait so long that they push the formation off. Its
weak modes turn 1 m/s2 of evasion into metres.
"""
FORMATION_TOLERANCE = 0.01
"""m: a drone farther from its place at the end of the law has not formed up."""
LawName = Annotated[
    Law, Meta(description='"normalised" or "paper"', examples=["paper"])
]
Letter = Annotated[Literal["S", "C"], Meta(description='"S" or "C"', examples=["S"])]


class Options(LeaderOptions, frozen=True, kw_only=True):
    """[mission_options]."""

    law: LawName = "normalised"
    """The law of the followers."""
    kp: Gain | None = None
    """1/s2: gain of the law. None: a gain that suits the law and the drones."""
    kv: Gain | None = None
    """1/s: gain of the law. None: a gain that suits the law and the drones."""
    in_height: Share | None = None
    """Share of kp and kv in height, for the paper's law."""
    shape: Places | None = None
    """m: places of the drones that have the wanted bearings."""
    letter: Letter | None = None
    """A letter as the shape."""
    size: Length = 3.0
    """m: height of the letter."""
    scatter: Spreads = (1.0, 1.0, 0.5)
    """m: largest random shift of the followers' starts, by axis."""


class Chosen(NamedTuple):
    """A law and its gains."""

    law: Law
    """The law."""
    kp: float
    """1/s2."""
    kv: float
    """1/s."""
    in_height: float
    """Share of kp and kv in height."""


class BearingFormation(CFDistributedFeedback):
    """Follower: the paper's law, or the normalised law, which uses the neighbours' accelerations.

        paper:       u_i = - D sum_j P_ij [ kp (p_i - p_j) + kv (v_i - v_j) ]
        normalised:  u_i = K_i^-1 sum_j P_ij [ - kp (p_i - p_j) - kv (v_i - v_j) + a_j ]
        P_ij = I - g_ij g_ij^T,   K_i = sum_j P_ij,   D = diag(1, 1, in_height)

    The modes of the paper's law are s^2 + kv l s + kp l, with l an eigenvalue of B_ff. All modes of
    the normalised law are s^2 + kv s + kp, on any graph. Therefore it is the default.

    a_j was commanded in the tick before. The law therefore takes p_j and v_j from that tick too
    (`paired`), and holds all three together when messages are lost. Equal delays cancel out, while
    unequal delays delay the modes of a large graph. If leaders move, equal delays would add up with
    each neighbour on the way. Then the law takes the newest p_j and v_j.

    i: id of the drone.
    shape: {id: (3,) m}, from which the bearings g_ij follow.
    neighbors: ids that drone i hears.
    law: "paper" or "normalised".
    kp: 1/s2.
    kv: 1/s.
    in_height: share of the gains in height, for the paper's law.
    moving: the leaders move.
    gains: gains of the control behind the law.
    Source: Zhao & Zelazo 2017, IEEE TCNS 4(3); the normalised law is their law for leaders that
    accelerate.
    """

    def __init__(
        self,
        i: int,
        shape: Shape,
        neighbors: Iterable[int],
        law: Law = "normalised",
        kp: float = 8.0,
        kv: float = 4.5,
        in_height: float = 1.0,
        moving: bool = False,
        gains: Gains = AGILE_GAINS,
    ) -> None:
        self.neighbors = tuple(neighbors)
        self.gains = gains
        weights: dict[int, Any] = {
            j: projector(np.subtract(shape[j], shape[i])) for j in self.neighbors
        }
        if law == "normalised":
            total = sum(weights.values())
            weights = {j: np.linalg.solve(total, p) for j, p in weights.items()}
        else:
            share = np.array([[1.0], [1.0], [in_height]])
            weights = {j: share * p for j, p in weights.items()}
        # The law as one product, u = W (x_i, x_j, ..., a_j, ...). Of a state x (13,) p and v count.
        blocks = [
            np.pad(np.kron([kp, kv], w), ((0, 0), (0, 7))) for w in weights.values()
        ]
        parts = [
            -sum(blocks),
            *blocks,
            *(weights.values() if law == "normalised" else ()),
        ]
        self.W = np.hstack(parts)
        self.a_counts = law == "normalised"
        self.paired = self.a_counts and not moving

    def height(self) -> float | None:
        """Return the height in the drone's options, so that it may start outside the plane."""
        return leader.height_of(self.member.config, self.id)

    def step(self, me: State, heard: Heard) -> Acceleration | None:
        """Return the acceleration of the law, or None to hover if a neighbour is not heard."""
        if len(heard) < len(self.neighbors):
            return None
        states = [me.flat, *(heard[j].flat for j in self.neighbors)]
        if self.a_counts:
            states += [heard[j].a for j in self.neighbors]
        return Acceleration(self.W.dot(np.concatenate(states)))


def guidance(i: int, config: SwarmConfig) -> CFDistributedFeedback:
    """Return the law of drone i: the law of a leader or of a follower."""
    options = given(config, Options)
    law = chosen(config)
    if config.drone(i).leader:
        return leader.leader_of(i, config, options)
    follower = BearingFormation(
        i,
        shape(config),
        neighbors(config)[i],
        moving=moving(config),
        gains=gains(config),
        **law._asdict(),
    )
    follower.duration = leader.duration_of(config, options)
    follower.rest = HOVER_BEFORE_LAW if law.law == "paper" else 0.0
    return follower


def chosen(config: SwarmConfig) -> Chosen:
    """Return the law with its gains. Gains that are not given depend on the law and the drones."""
    options = given(config, Options)
    kp = bearing.BEARING_GAINS.kp_normalised
    kv = bearing.BEARING_GAINS.kv_normalised
    in_height = 1.0
    if options.law == "paper" and on_motors(config):
        kp = bearing.BEARING_GAINS.kp_on_motors
        kv = bearing.BEARING_GAINS.kv_on_motors
        in_height = bearing.BEARING_GAINS.height_share
    elif options.law == "paper":
        kp = bearing.BEARING_GAINS.kp
        kv = bearing.BEARING_GAINS.kv
    return Chosen(
        options.law, options.kp or kp, options.kv or kv, options.in_height or in_height
    )


def gains(config: SwarmConfig) -> Gains:
    """Return the gains of the control behind the law."""
    if given(config, Options).law == "normalised":
        return AGILE_GAINS
    return FORMATION_GAINS_ON_MOTORS if on_motors(config) else FORMATION_GAINS


def on_motors(config: SwarmConfig) -> bool:
    """Return whether every drone has a rate loop on board; only lightweight drones have none."""
    return all(drone.uri != WORLD_URIS.lightweight for drone in config.drones)


def moving(config: SwarmConfig) -> bool:
    """Return whether the leaders fly a path."""
    return given(config, Options).leaders != "still"


def shape(config: SwarmConfig) -> Shape:
    """Return the shape, {id: (3,) m}.

    It is that of the mission options. Without one it is the square for four drones, else the homes.
    """
    options = given(config, Options)
    if options.letter is not None:
        places = shapes.letter(options.letter, options.size)
        require_each(config, places, "letter")
        return places
    if options.shape is not None:
        require_each(config, options.shape, "shape")
        return options.shape
    return (
        shapes.PAPER_SQUARE
        if config.ids == tuple(shapes.PAPER_SQUARE)
        else {drone.id: drone.home for drone in config.drones}
    )


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return a swarm with this number of drones.

    4: the paper's square.
    30: a grid of 0.6 m, with leaders at its corners.
    11: a letter, with leaders at its ends.
    Raises ConfigError for any other number.
    """
    match drones or 4:
        case 4:
            return _swarm(
                "bearing",
                shapes.PAPER_SQUARE,
                shapes.PAPER_SQUARE_EDGES,
                (0, 1),
                {"scatter": [1.0, 1.0, 0.5]},
            )
        case 11:
            places = shapes.letter("S", 3.0)
            extra = {"scatter": [0.3, 0.3, 0.2], "letter": "S", "size": 3.0}
            return _swarm(
                "letter", places, shapes.nearest_edges(places, 31), (0, 1), extra
            )
        case 30:
            extra = {"scatter": [0.2, 0.2, 0.2]}
            places = shapes.grid(6, 5, 0.6)
            given = {"shape": {str(i): list(p) for i, p in places.items()}}
            return _swarm(
                "grid",
                places,
                shapes.grid_edges(6, 5),
                shapes.corners(6, 5),
                extra | given,
            )
    raise ConfigError(
        "--drones",
        drones,
        "4 (a square), 11 (a letter) or 30 (a grid)",
        "Or write a swarm file.",
    )


def _swarm(
    name: str,
    places: Shape,
    edges: list[list[int]],
    leaders: tuple[int, ...],
    extra: dict[str, Any],
) -> SwarmConfig:
    return SwarmConfig.of(
        {
            "name": name,
            "mission": "bearing_formation",
            "edges": edges,
            "drones": [
                {"id": i, "home": [*p[:2], 0.0], "leader": i in leaders}
                for i, p in places.items()
            ],
            "flight": {"speed_limit": 2.0, "acceleration_limit": 4.0},
            "plant": {"rate_lag": 0.0, "command_delay": 0.0},
            "collision": BRISK_COLLISION,
            "mission_options": extra,
        }
    )


def scatter(config: SwarmConfig) -> SwarmConfig:
    """Return the swarm with the starts of its followers moved at random, clear of each other.

    Each start moves by up to `scatter` (3,) m an axis.
    """
    return scatter_swarm(config, Scatter(*given(config, Options).scatter))


def goal(config: SwarmConfig) -> dict[int, Vec]:
    """Return where the law is at rest, with the leaders at their last places."""
    at_last = leader.leaders_at_last(config, given(config, Options))
    return bearing.compute_equilibrium(
        shape(config), neighbors(config), {i: tuple(p) for i, p in at_last.items()}
    )


def neighbors(config: SwarmConfig) -> dict[int, tuple[int, ...]]:
    """Return the ids that each drone hears."""
    graph = config.graph()
    return {i: graph.in_neighbors(i) for i in graph.ids}


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Refuse a formation that cannot be flown, and return warnings.

    Raises Refused if the bearings do not hold the shape on this graph, or if the formation would
    take minutes. Raises ConfigError if the leaders cannot fly their paths.
    """
    slowest = max(
        (find_platform(drone.platform) for drone in config.drones),
        key=lambda found: found.rotor.lag,
    )
    chain = (
        AccelerationChain.of_motors(gains(config), slowest)
        if on_motors(config)
        else AccelerationChain(gains(config))
    )
    report = check_formation(
        shape(config),
        neighbors(config),
        list(leader.leaders_of(config)),
        **chosen(config)._asdict(),
        moving=moving(config),
        chain=chain,
        force=force,
    )
    leader.require_flyable(config, given(config, Options))
    return list(report.warnings)


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Check that every drone is in its place at the end of the law, by its own estimate.

    The reasons name each drone that is not, with the neighbours that it did not hear.
    """
    goals = goal(config)
    reasons = {}
    for i, result in results.items():
        far = (
            float(np.linalg.norm(goals[i] - result["place"]))
            if "place" in result
            else 0.0
        )
        if far > FORMATION_TOLERANCE:
            reasons[i] = (
                f"{far:.3f} m from its place at the end of the law, allowed {FORMATION_TOLERANCE} m{_deaf(result)}"
            )
    return {"success": not reasons, "reasons": reasons}


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the flown paths from above."""
    draw_tracks(
        results,
        path,
        leaders=list(leader.leaders_of(config)),
        edges=config.graph().edges(),
    )


def _deaf(result: dict[str, Any]) -> str:
    unheard = ", ".join(
        f"drone {j} for {seconds:.2f} s" for j, seconds in result["unheard_s"].items()
    )
    return f"; did not hear {unheard}" if unheard else ""
