"""One drone, or several side by side, fly a hand-drawn path: by default the word "Casy".

crazychoir run drawn_path --fast --picture out/casy.png
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.config.tables import Scale, SwarmTable, Text
from crazychoir.control.gains import STANDARD_GAINS
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission_options import Offset, Yaw, given, require_none
from crazychoir.guidance.path_checks import require_inside
from crazychoir.guidance.timed import Way, record_way
from crazychoir.planning.drawing.drawing import Drawing, Pen, plan_drawing
from crazychoir.planning.drawing.drawing_file import read_drawing
from crazychoir.planning.feasibility import Limits

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
WORD_DRAWING = Path(__file__).parent / "data" / "casy.csv"
"""The drawing of the word "Casy"."""
DRAWING_TOLERANCE = 0.03
"""m: largest distance between the flown path and the drawn path."""
Timing = Annotated[
    Literal["even", "drawn"], Meta(description='"even" or "drawn"', examples=["drawn"])
]


class Options(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    drawing: Text = str(WORD_DRAWING)
    """A CSV file of rows stroke, t, x, y, or an SVG picture with a unit of 1 mm."""
    scale: Scale = 1.0
    """Scale of the drawing."""
    yaw: Yaw = 0.0
    """rad, or "along" the path."""
    timing: Timing = "even"
    """"drawn": as fast as the hand was, where the limits allow (CSV only)."""
    lift: Offset = 0.1
    """m: height of the flight between strokes, above the drawing."""


class Writer(CFGuidance):
    """Flies a drawing."""

    def __init__(self, drawn: Drawing) -> None:
        self.drawn = drawn
        self.way = Way()

    async def mission(self) -> dict[str, Any]:
        """Take off, fly along the drawing, go home, land."""
        await self.take_off()
        await self.rendezvous()
        home = self.state.p.copy()
        await self.go_to(self.drawn.path.sample(0.0).p)
        async with record_way(self, self.way):
            await self.fly(self.drawn.path)
        await self.go_to(home)
        await self.land()
        return {"place": self.state.p.tolist(), "way": self.way.rows}


def drawn(config: SwarmConfig, i: int) -> Drawing:
    """Return the drawing that drone i flies, with its centre over the drone's home.

    Its jerk is limited to what the attitude of the drone can follow.
    Raises ConfigError if it cannot be flown.
    """
    options = given(config, Options)
    flight = config.flight
    home = config.drone(i).home
    strokes = read_drawing(options.drawing).strokes
    places = np.vstack([stroke[:, -2:] for stroke in strokes])
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    placed = [
        np.column_stack(
            [stroke[:, :-2], home[:2] + options.scale * (stroke[:, -2:] - middle)]
        )
        for stroke in strokes
    ]
    pen = Pen(
        height=flight.ground + flight.takeoff_height,
        lift=options.lift,
        yaw=options.yaw,
        timing=options.timing,
    )
    limits = Limits(
        v_max=flight.speed_limit,
        a_max=flight.acceleration_limit,
        j_max=STANDARD_GAINS.kr[0] * flight.acceleration_limit,
        low=config.fence.min,
        high=config.fence.max,
    )
    planned = plan_drawing(placed, pen, limits)
    require_inside(planned.path, config, i, "drawing")
    return planned


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the guidance of drone i: it writes over its home."""
    return Writer(drawn(config, i))


def swarm(drones: int | None) -> SwarmConfig:
    """Return drones side by side, 1.5 m apart along y, each with room for the word."""
    n = drones or 1
    return SwarmConfig.of(
        {
            "name": "writers",
            "mission": "drawn_path",
            "graph": "ring" if n > 1 else "empty",
            "drones": [{"id": i, "home": [0.0, 1.5 * i, 0.0]} for i in range(n)],
            "fence": {"min": [-3.0, -3.0, 0.0], "max": [3.0, 1.5 * n + 1.5, 3.0]},
        }
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check the options and the drawing. Returns how it will be flown, and which parts are ignored.

    Raises ConfigError if the drawing cannot be flown.
    """
    options = given(config, Options)
    require_none(config)
    flown, *_ = [_checked(config, i) for i in config.ids]
    return [
        f"the drawing takes {flown.path.duration:.1f} s, at most {flown.speed:.2f} m/s and "
        f"{flown.acceleration:.2f} m/s2, {1e3 * flown.deviation:.1f} mm from what was drawn",
        *(f"{options.drawing}: {word}" for word in read_drawing(options.drawing).words),
    ]


def _checked(config: SwarmConfig, i: int) -> Drawing:
    try:
        return drawn(config, i)
    except ConfigError as error:
        raise ConfigError(
            f"drone {i}: {error.where}",
            error.found,
            error.allowed,
            error.do,
            error.problem,
        ) from error


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Report how the drawing is flown, and compare the flown path with the drawing."""
    flown = drawn(config, config.ids[0])
    off = {i: written(config, i, results.get(i, {})) for i in config.ids}
    reasons = {
        i: f"{1e3 * far:.0f} mm from its drawing, allowed {1e3 * DRAWING_TOLERANCE:.0f} mm"
        for i, far in off.items()
        if not far <= DRAWING_TOLERANCE
    }
    return {
        "success": not reasons,
        "reasons": reasons,
        "written_mm": {i: 1e3 * far for i, far in off.items()},
        "drawing_s": flown.path.duration,
        "speed_m_s": flown.speed,
        "acceleration_m_s2": flown.acceleration,
        "deviation_mm": 1e3 * flown.deviation,
    }


def written(config: SwarmConfig, i: int, result: dict[str, Any]) -> float:
    """Return the Hausdorff distance in m between the flown path of drone i and its drawing.

    A small distance means that no place is off, and that no place is left out.
    """
    way = np.array(result.get("way", []))
    path = drawn(config, i).path
    if len(way) < 2:
        return float("inf")
    wanted = path.samples(np.arange(0.0, path.duration, 0.02))[:, 0:3]
    t = np.arange(0.0, way[-1, 0], 0.02)
    flown = CubicSpline(way[:, 0], way[:, 1:4])(t)
    return float(
        max(
            cKDTree(wanted).query(flown)[0].max(), cKDTree(flown).query(wanted)[0].max()
        )
    )


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the planned path (broad) and the flown path."""
    import matplotlib.pyplot as plt  # takes 1 s and a font cache: imported only for a picture

    shown, axes = plt.subplots(figsize=(7.0, 3.5))
    for i in config.ids:
        wanted = drawn(config, i).path
        x, y, _ = wanted.samples(np.arange(0.0, wanted.duration, 0.02))[:, 0:3].T
        axes.plot(x, y, color="#cccccc", linewidth=4.0)
        if way := results.get(i, {}).get("way"):
            axes.plot(*np.array(way)[:, 1:3].T, linewidth=1.2, label=f"drone {i}")
    axes.set(xlabel="x in m", ylabel="y in m", aspect="equal")
    axes.legend(fontsize=7)
    shown.savefig(path, dpi=150, bbox_inches="tight")
    plt.close(shown)
