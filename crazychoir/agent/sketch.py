"""Hand-drawn strokes made into a flight: smoothed, timed, checked against limits and fence, and
shifted.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.agent.command_arguments import MOST_PIECES, path_message
from crazychoir.config.flight_room import largest_room
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import CollisionTable
from crazychoir.errors import ConfigError
from crazychoir.guidance.path_checks import get_place_limits
from crazychoir.planning.drawing.drawing import Pen, plan_drawing
from crazychoir.planning.drawing.drawing_file import (
    DrawingFile,
    parse_drawing,
    read_drawing,
)
from crazychoir.planning.drawing.stroke import format_strokes, thin_line
from crazychoir.planning.drawing.svg import format_svg
from crazychoir.planning.feasibility import (
    Limits,
    check_limits,
    compute_peaks,
    sample_references,
)
from crazychoir.planning.number_table import read_table_text
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.placed_trajectory import place_trajectory
from crazychoir.planning.trajectory_file import has_pieces, parse_pieces
from crazychoir.planning.upload import require_memory
from crazychoir.types import Mat

Offset = tuple[float, float, float]
"""(3,) m, world: from one drone to the next."""


@dataclass(frozen=True, slots=True)
class SketchLimits:
    """Limits and defaults of flights along drawings."""

    hand_deviation: float = 0.02
    """m: how far a hand strays from the intended line."""
    yaw_rate: float = 2.0
    """rad/s: largest yaw rate of a drone that looks along its path."""
    shown_places: int = 400
    """Number of places of a path on the page."""
    least_step: float = 0.002
    """m: smallest distance between two places of a loaded stroke."""
    loaded_rows: int = 5000
    """Largest number of rows of all strokes of a loaded file.

    It is what a page can send at once, for files with less than half as many strokes.
    """
    time_step: float = 0.02
    """s between two places of a stroke without times."""
    most_rows: int = 20_000
    """Largest number of rows of all strokes of a drawing."""
    largest_slowdown: float = 20.0
    """Largest factor on the time that the limits need."""
    longest_flight: float = 1800.0
    """s: longest flight along a drawing. A battery lasts for a fifth of that."""


SKETCH_LIMITS = SketchLimits()


@dataclass(frozen=True)
class PlannedSketch:
    """A flight as it will be flown, before it is shifted."""

    path: Piecewise
    """The path."""
    deviation: float
    """m: largest distance of the flown lines from the drawn lines."""
    speed: float
    """m/s: largest."""
    acceleration: float
    """m/s2: largest."""

    def shown(self) -> dict[str, Any]:
        """Return the flight for the page: places, speeds and accelerations at equal times."""
        t = np.linspace(0.0, self.path.duration, SKETCH_LIMITS.shown_places)
        x = self.path.samples(t)
        return {
            "points": x[:, 0:3].round(3).tolist(),
            "duration": round(self.path.duration, 2),
            "deviation": round(self.deviation, 4),
            "speed": round(self.speed, 3),
            "acceleration": round(self.acceleration, 3),
            "speeds": np.linalg.norm(x[:, 3:6], axis=1).round(3).tolist(),
            "accelerations": np.linalg.norm(x[:, 6:9], axis=1).round(3).tolist(),
        }


def plan_sketch(
    strokes: Iterable[Any],
    pen: Pen,
    config: SwarmConfig,
    v_max: float = 0.5,
    a_max: float = 1.0,
    slower: float = 1.0,
) -> PlannedSketch:
    """Return the flight along the strokes.

    A drawing that is far too large is refused before it takes much computing time.

    strokes: each (n, 3), rows t s, x, y m.
    pen: how to fly the strokes.
    config: the swarm file.
    v_max: m/s, at most that of [flight].
    a_max: m/s2, at most that of [flight].
    slower: factor on the time that the limits need, 1 to largest_slowdown.
    Raises ConfigError for a drawing that cannot be flown.
    """
    if not 1.0 <= slower <= SKETCH_LIMITS.largest_slowdown:
        raise ConfigError(
            "drawing: slower",
            slower,
            f"1 to {SKETCH_LIMITS.largest_slowdown:g} times as long as the limits ask for",
        )
    flight = config.flight
    v_max = min(v_max, flight.speed_limit)
    a_max = min(a_max, flight.acceleration_limit)
    limits = Limits(
        v_max=v_max,
        a_max=a_max,
        yaw_rate_max=SKETCH_LIMITS.yaw_rate,
        low=config.fence.min,
        high=config.fence.max,
    )
    drawn = [np.array(stroke, dtype=float) for stroke in strokes]
    _check_size(drawn, pen, limits, slower)
    made = plan_drawing(drawn, pen, limits, SKETCH_LIMITS.longest_flight / slower)
    path = made.path.slowed(slower)
    check_limits(path, limits)
    low, high = largest_room(config)
    Limits(low=low, high=high).check_places(
        sample_references(path)[1][:, 0:3], "drawing: set-point"
    )
    most = compute_peaks(path)
    return PlannedSketch(path, made.deviation, most["speed"], most["acceleration"])


def plan_trajectory(
    path: Piecewise,
    config: SwarmConfig,
    where: str,
    slower: float = 1.0,
    height: float | None = None,
) -> PlannedSketch:
    """Return the flight along a trajectory of a file; its places are checked for each drone later.

    where: name of the file, for errors
    slower: factor on its duration, 1 / largest_slowdown to largest_slowdown
    height: m, world: height of its start; None: as in the file
    Raises ConfigError for a trajectory that cannot be flown.
    """
    most = SKETCH_LIMITS.largest_slowdown
    if not 1.0 / most <= slower <= most:
        raise ConfigError(
            f"{where}: slower",
            slower,
            f"{1.0 / most:g} to {most:g} times as long as in the file",
        )
    flight = config.flight
    limits = Limits(v_max=flight.speed_limit, a_max=flight.acceleration_limit)
    placed = place_trajectory(path, limits, where, slower, height)
    if placed.duration > SKETCH_LIMITS.longest_flight:
        raise ConfigError(
            where,
            f"{placed.duration:.0f} s",
            f"at most {SKETCH_LIMITS.longest_flight:.0f} s",
        )
    peaks = compute_peaks(placed)
    return PlannedSketch(placed, 0.0, peaks["speed"], peaks["acceleration"])


def _check_size(strokes: list[Mat], pen: Pen, limits: Limits, slower: float) -> None:
    """Raise ConfigError for a drawing that is too large.

    It may have too many rows, places beyond the fence, or lines too long for a message or for
    longest_flight. The hand may stray beyond the fence by the smoothing: the flown path is checked again.
    """
    if (rows := sum(map(len, strokes))) > SKETCH_LIMITS.most_rows:
        raise ConfigError(
            "drawing",
            f"{rows} rows",
            f"at most {SKETCH_LIMITS.most_rows}",
            "Draw less at once.",
        )
    for n, stroke in enumerate(strokes):
        places = np.column_stack([stroke[:, 1:3], np.full(len(stroke), pen.height)])
        near = np.clip(places, limits.low, limits.high)
        limits.check_places(
            np.where(np.abs(places - near) > pen.smoothing, places, near),
            f"strokes[{n}]",
        )
    lines = sum(_stroke_length(stroke[:, 1:3]) for stroke in strokes)
    longest = MOST_PIECES * pen.spacing
    if lines > 2.0 * longest:  # much of the length may be tremor of the hand
        raise ConfigError(
            "drawing",
            f"{lines:.0f} m",
            f"at most {longest:.0f} m",
            "Draw less at once.",
        )
    way = _stroke_length(
        np.vstack([np.empty((0, 2)), *(stroke[:, 1:3] for stroke in strokes)])
    )
    seconds = slower * (way + 2.0 * pen.lift * max(len(strokes) - 1, 0)) / limits.v_max
    if seconds > SKETCH_LIMITS.longest_flight:
        do = "Draw less at once, or let it be faster."
        raise ConfigError(
            "drawing",
            f"{way:.0f} m, which take {seconds:.0f} s",
            f"at most {SKETCH_LIMITS.longest_flight:.0f} s",
            do,
        )


def _stroke_length(places: Mat) -> float:
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def flight_places(
    p: Sequence[float], offset: Offset, drones: Sequence[int], config: SwarmConfig
) -> dict[int, list[float]]:
    """Return {drone id: goal (3,) m, world}: the k-th drone flies to p + k offset, k = 0, 1, ...

    Raises ConfigError if two goals are too near to each other.
    """
    _check_apart(drones, offset, config)
    return _place_beside(p, offset, drones)


def _place_beside(
    p: Sequence[float], offset: Offset, drones: Sequence[int]
) -> dict[int, list[float]]:
    return {
        i: [x + k * step for x, step in zip(p, offset, strict=True)]
        for k, i in enumerate(drones)
    }


def flight_messages(
    path: Piecewise,
    drones: Sequence[int],
    offset: Offset,
    config: SwarmConfig,
    is_relative: bool = False,
) -> dict[int, dict[str, Any]]:
    """Return {drone id: arguments of the command `fly`}.

    The k-th drone flies the path shifted by k offset, k = 0, 1, ... A leader of a formation flies the
    path from its present place, so the distance between leaders alone is not checked. With
    `is_relative` each drone flies the path from its present place, and checks its places itself.

    path: the planned flight
    drones: ids
    offset: (3,) m, from drone to drone
    config: the swarm file
    is_relative: whether the path begins where each drone is
    Raises ConfigError if a path leaves the fence, or if two drones would be so near that one of them
    always had to give way.
    """
    if is_relative:
        return {i: path_message(path) | {"relative": True} for i in drones}
    if not all(config.drone(i).leader for i in drones):
        _check_apart(drones, offset, config)
    told = {}
    ways = sample_references(path)[1][:, 0:3]
    for i, by in _place_beside((0.0, 0.0, 0.0), offset, drones).items():
        get_place_limits(config, i).check_places(ways + by, f"path of drone {i}")
        told[i] = path_message(path.shifted(by))
    return told


def on_board_messages(
    messages: dict[int, dict[str, Any]], slower: float, is_reversed: bool
) -> dict[int, dict[str, Any]]:
    """Return the arguments of `fly` for flights from the memory of each drone.

    The memory holds the trajectory at its own pace and from its start; the planner on board slows and
    reverses it.

    messages: what `flight_messages` returns, of the flights as they are flown
    slower: factor by which these flights are slower
    is_reversed: whether these flights are reversed
    Raises ConfigError for a trajectory that does not fit into the memory.
    """
    told = {}
    for i, message in messages.items():
        flown = Piecewise(message["coefficients"], message["durations"])
        plain = flown.reversed() if is_reversed else flown
        plain = plain.slowed(1.0 / slower)
        require_memory(plain)
        on_board = {"timescale": slower, "reversed": is_reversed}
        told[i] = {**message, **path_message(plain), "on_board": on_board}
    return told


def _check_apart(drones: Sequence[int], offset: Offset, config: SwarmConfig) -> None:
    """Raise ConfigError if two drones would be nearer than the collision filter allows."""
    collision = config.collision
    if (
        len(drones) > 1
        and collision.method != "off"
        and _are_too_near(offset, collision)
    ):
        (a, _, c), margin = collision.semi_axes, collision.margin
        allowed = f"{2.0 * a + margin:g} m aside, or {2.0 * c:g} m above, from one drone to the next"
        raise ConfigError(
            "offset", list(offset), allowed, "Set it, or send one drone alone."
        )


def _are_too_near(offset: Offset, collision: CollisionTable) -> bool:
    """Return whether two drones at this offset are nearer than the collision filter allows."""
    (a, _, c), (x, y, z) = collision.semi_axes, offset
    return (
        math.hypot(math.hypot(x, y) / (2.0 * a + collision.margin), z / (2.0 * c)) < 1.0
    )


def load_with_remarks(
    text: str, name: str
) -> tuple[list[list[list[float]]], list[str]]:
    """Return the strokes of a CSV or SVG text, thinned, and remarks on what is not flown.

    The strokes have rows t s, x, y m.
    Raises ConfigError if the text is not a drawing.
    """
    drawn = parse_drawing(text, name)
    return _thin_strokes(drawn), drawn.words


def plan_file(
    path: Path,
    config: SwarmConfig,
    height: float | None,
    v_max: float,
    slower: float,
    is_reversed: bool = False,
) -> PlannedSketch:
    """Return the flight along the strokes or the trajectory of a file.

    height: m, world: height of the strokes, or of the start of the trajectory; None: the take-off
        height, or as in the file
    v_max: m/s, along strokes
    slower: factor on the shortest duration along strokes, or on the duration of the trajectory
    is_reversed: whether to fly from the end to the start; `height` is then that of the end of the file
    Raises ConfigError for a file that cannot be read or flown.
    """
    if path.suffix.lower() == ".csv" and has_pieces(text := read_table_text(path)):
        whole = parse_pieces(text, path)
        whole = whole.reversed() if is_reversed else whole
        return plan_trajectory(whole, config, str(path), slower, height)
    if height is None:
        height = config.flight.ground + config.flight.takeoff_height
    pen = Pen(height=height, smoothing=SKETCH_LIMITS.hand_deviation)
    plan = plan_sketch(load_file(path), pen, config, v_max=v_max, slower=slower)
    return replace(plan, path=plan.path.reversed()) if is_reversed else plan


def load_file(path: Path) -> list[list[list[float]]]:
    """Return the strokes of a CSV or SVG file, in any encoding that it may have.

    Raises ConfigError if the file is not a drawing.
    """
    return _thin_strokes(read_drawing(path))


def _thin_strokes(drawn: DrawingFile) -> list[list[list[float]]]:
    strokes = [_add_times(stroke) for stroke in drawn.strokes]
    length = sum(
        float(np.linalg.norm(np.diff(stroke[:, 1:], axis=0), axis=1).sum())
        for stroke in strokes
    )
    step = max(
        SKETCH_LIMITS.least_step,
        length / max(SKETCH_LIMITS.loaded_rows - 2 * len(strokes), 1),
    )
    return [
        stroke[thin_line(stroke[:, 1:], step)].round(4).tolist() for stroke in strokes
    ]


def strokes_as_text(strokes: list[Mat], kind: str) -> str:
    """Return the strokes as a CSV or SVG text."""
    timed = [_add_times(stroke) for stroke in strokes]
    return format_svg(timed) if kind == "svg" else format_strokes(timed)


def _add_times(stroke: Mat) -> Mat:
    if stroke.shape[1] == 3:
        return stroke
    return np.column_stack([SKETCH_LIMITS.time_step * np.arange(len(stroke)), stroke])
