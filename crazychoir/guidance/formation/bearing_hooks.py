"""What a bearing formation needs beside its law: options, gains, its own swarms, checks, report."""

import math
from typing import Annotated, Any, Literal

from msgspec import Meta

from crazychoir.config.calibrated import find_known_platform
from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.shared_values import share
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import Share
from crazychoir.control.gains import (
    AGILE_GAINS,
    FORMATION_GAINS,
    FORMATION_GAINS_ON_MOTORS,
    Gains,
)
from crazychoir.errors import ConfigError
from crazychoir.guidance.formation import leader, shapes
from crazychoir.guidance.formation.bearing import (
    BEARING_GAINS,
    BearingLaw,
    Law,
    check_formation,
    compute_equilibrium,
    find_distortion,
)
from crazychoir.guidance.formation.formation_hooks import FormationHooks, list_neighbors
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
from crazychoir.guidance.mission_report import Results, describe_distances
from crazychoir.types import Vec

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
DISTORTION_TOLERANCE = math.radians(1.0)
"""rad: largest angle between bearings of the formation and of the shape without a warning."""
LawName = Annotated[
    Law, Meta(description='"normalised" or "paper"', examples=["paper"])
]
Letter = Annotated[Literal["S", "C"], Meta(description='"S" or "C"', examples=["S"])]


class BearingOptions(LeaderOptions, frozen=True, kw_only=True):
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


class BearingHooks(FormationHooks[BearingOptions]):
    """The hooks of a formation in which followers find their places from bearings."""

    def law(self, config: SwarmConfig) -> BearingLaw:
        """Return the law with its gains.

        Gains that are not given depend on the law and the drones.
        """
        options = self.given(config)
        kp = BEARING_GAINS.kp_normalised
        kv = BEARING_GAINS.kv_normalised
        in_height = 1.0
        if options.law == "paper" and have_rate_loops(config):
            kp = BEARING_GAINS.kp_on_motors
            kv = BEARING_GAINS.kv_on_motors
            in_height = BEARING_GAINS.height_share
        elif options.law == "paper":
            kp = BEARING_GAINS.kp
            kv = BEARING_GAINS.kv
        return BearingLaw(
            options.law,
            options.kp or kp,
            options.kv or kv,
            options.in_height or in_height,
        )

    def gains(self, config: SwarmConfig) -> Gains:
        """Return the gains of the control behind the law."""
        if self.given(config).law == "normalised":
            return AGILE_GAINS
        return FORMATION_GAINS_ON_MOTORS if have_rate_loops(config) else FORMATION_GAINS

    def rest(self, config: SwarmConfig) -> float:
        """Return how long drones hover before the law, in s."""
        return HOVER_BEFORE_LAW if self.given(config).law == "paper" else 0.0

    def leaders_move(self, config: SwarmConfig) -> bool:
        """Return whether the leaders fly a path."""
        return self.given(config).leaders != "still"

    def neighbors(self, config: SwarmConfig) -> dict[int, tuple[int, ...]]:
        """Return the ids that each drone hears."""
        return list_neighbors(config)

    def shape(self, config: SwarmConfig) -> Shape:
        """Return the shape, {id: (3,) m}.

        It is that of the mission options. Without one it is the square for four drones, else the
        homes. All drones get the same dictionary.
        """
        return share(config, _find_shape, self.options)

    def swarm(self, drones: int | None = None) -> SwarmConfig:
        """Return a swarm with this number of drones.

        4: the paper's square.
        30: a grid of 0.6 m, with leaders at its corners.
        11: a letter, with leaders at its ends.
        Raises ConfigError for any other number.
        """
        match drones or 4:
            case 4:
                return _build_swarm(
                    "bearing",
                    shapes.PAPER_SQUARE,
                    shapes.PAPER_SQUARE_EDGES,
                    (0, 1),
                    {"scatter": [1.0, 1.0, 0.5]},
                )
            case 11:
                places = shapes.letter("S", 3.0)
                return _build_swarm(
                    "letter",
                    places,
                    shapes.nearest_edges(places, 31),
                    (0, 1),
                    {"scatter": [0.3, 0.3, 0.2], "letter": "S", "size": 3.0},
                )
            case 30:
                places = shapes.grid(6, 5, 0.6)
                shape = {str(i): list(p) for i, p in places.items()}
                return _build_swarm(
                    "grid",
                    places,
                    shapes.grid_edges(6, 5),
                    shapes.corners(6, 5),
                    {"scatter": [0.2, 0.2, 0.2], "shape": shape},
                )
        raise ConfigError(
            "--drones",
            drones,
            "4 (a square), 11 (a letter) or 30 (a grid)",
            "Or write a swarm file.",
        )

    def scatter(self, config: SwarmConfig) -> SwarmConfig:
        """Return the swarm with the starts of its followers moved at random, clear of each other.

        Each start moves by up to `scatter` (3,) m an axis.
        """
        return scatter_swarm(config, Scatter(*self.given(config).scatter))

    def goal(self, config: SwarmConfig) -> dict[int, Vec]:
        """Return where the law is at rest, with the leaders at their last places."""
        at_last = leader.leaders_at_last(config, self.given(config))
        return compute_equilibrium(
            self.shape(config),
            self.neighbors(config),
            {i: tuple(p) for i, p in at_last.items()},
        )

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Refuse a formation that cannot be flown, and return warnings.

        Raises Refused if the bearings do not hold the shape on this graph, or if the formation
        would take minutes. Raises ConfigError if the leaders cannot fly their paths.
        """
        report = check_formation(
            self.shape(config),
            self.neighbors(config),
            list(leader.leaders_of(config)),
            self.law(config),
            moving=self.leaders_move(config),
            chain=self._chain(config),
            force=force,
        )
        super().check(config, force)
        return [*report.warnings, *self._describe_distortion(config)]

    def _describe_distortion(self, config: SwarmConfig) -> list[str]:
        """Return a warning if the leaders distort the shape, else nothing."""
        places = self.goal(config)
        angle, i, j = find_distortion(
            self.shape(config), self.neighbors(config), places
        )
        if angle <= DISTORTION_TOLERANCE:
            return []
        return [
            f"the formation will not be the shape: seen from drone {i}, drone {j} will be {math.degrees(angle):.1f} "
            "degrees beside its direction, because the leaders do not stand as in the shape. "
            "Leaders keep their homes: place these as in the shape, or as in the shape moved or scaled"
        ]

    def _chain(self, config: SwarmConfig) -> AccelerationChain:
        """Return the dynamics between law and drone, for the drone with the slowest rotors."""
        platforms = [find_known_platform(drone) for drone in config.drones]
        slowest = max(platforms, key=lambda platform: platform.rotor.lag)
        if have_rate_loops(config):
            return AccelerationChain.of_motors(self.gains(config), slowest)
        return AccelerationChain(self.gains(config))

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Check that every drone is in its place at the end of the law, by its own estimate.

        The reasons name each drone that is not, with the neighbours that it did not hear.
        """
        far = describe_distances(
            self.goal(config),
            results,
            FORMATION_TOLERANCE,
            "its place at the end of the law",
        )
        reasons = {i: text + _describe_unheard(results[i]) for i, text in far.items()}
        return {"success": not reasons, "reasons": reasons}


def have_rate_loops(config: SwarmConfig) -> bool:
    """Return whether every drone has a rate loop on board; only lightweight drones have none."""
    return share(config, _lacks_lightweight_drones)


def _lacks_lightweight_drones(config: SwarmConfig) -> bool:
    return all(drone.uri != WORLD_URIS.lightweight for drone in config.drones)


def _find_shape(config: SwarmConfig, kind: type[BearingOptions]) -> Shape:
    """Return the shape of the mission options, of the paper for four drones, or of the homes.

    kind: the table of [mission_options].
    """
    options = given(config, kind)
    if options.letter is not None:
        places = shapes.letter(options.letter, options.size)
        require_each(config, places, "letter")
        return places
    if options.shape is not None:
        require_each(config, options.shape, "shape")
        return options.shape
    if config.ids == tuple(shapes.PAPER_SQUARE):
        return shapes.PAPER_SQUARE
    return {drone.id: drone.home for drone in config.drones}


def _build_swarm(
    name: str,
    places: Shape,
    edges: list[list[int]],
    leaders: tuple[int, ...],
    options: dict[str, Any],
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
            "mission_options": options,
        }
    )


def _describe_unheard(result: dict[str, Any]) -> str:
    unheard = ", ".join(
        f"drone {j} for {seconds:.2f} s" for j, seconds in result["unheard_s"].items()
    )
    return f"; did not hear {unheard}" if unheard else ""
