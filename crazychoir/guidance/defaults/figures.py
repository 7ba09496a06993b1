"""What a mission of circles and eights needs: options, checks, report, picture."""

from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import SwarmTable
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission_options import (
    Laps,
    Length,
    Period,
    Ramp,
    Yaw,
    given,
    require_none,
)
from crazychoir.guidance.mission_pictures import draw_plans
from crazychoir.guidance.mission_report import Results
from crazychoir.guidance.path_checks import require_inside
from crazychoir.planning import feasibility
from crazychoir.planning.feasibility import Limits
from crazychoir.planning.figure import Figure, circle, eight
from crazychoir.types import Mat

FigureKind = Annotated[
    Literal["circle", "eight"],
    Meta(description='"circle" or "eight"', examples=["eight"]),
]
YawRate = Annotated[
    float, Meta(ge=-20, le=20, description="a rate in rad/s, -20 to 20", examples=[0.5])
]


class FigureOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    figure: FigureKind = "circle"
    """The figure."""
    size: Length = 0.4
    """m: radius of the circle, or half the width of the eight."""
    period: Period = 10.0
    """s: time of a lap at full speed."""
    laps: Laps = 2.0
    """Number of laps."""
    ramp: Ramp = 0.0
    """s: from rest to full speed. 0: half a period."""
    yaw: Yaw = 0.0
    """rad: yaw at the start, or "along" the path."""
    yaw_rate: YawRate = 0.0
    """rad/s."""


class FigureHooks:
    """The hooks of drones that each fly a figure around their home.

    options: the table of [mission_options].
    """

    def __init__(self, options: type[FigureOptions]) -> None:
        self.options = options

    def figure(self, config: SwarmConfig, i: int) -> Figure:
        """Return the figure of drone i, at the take-off height above its home."""
        options = given(config, self.options)
        x, y, z = config.drone(i).home
        center = (x, y, z + config.flight.takeoff_height)
        timing = (
            options.period,
            options.laps,
            options.ramp or None,
            options.yaw,
            options.yaw_rate,
        )
        if options.figure == "circle":
            return circle(center, options.size, *timing)
        return eight(center, (options.size, 0.5 * options.size), *timing)

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check the options, and that each drone can fly its figure. Raises ConfigError if not."""
        given(config, self.options)
        require_none(config)
        limits = Limits(
            v_max=config.flight.speed_limit,
            a_max=config.flight.acceleration_limit,
            low=config.fence.min,
            high=config.fence.max,
        )
        for i in config.ids:
            try:
                feasibility.check_limits(self.figure(config, i), limits)
                require_inside(self.figure(config, i), config, i, "trajectory")
            except ConfigError as error:
                raise ConfigError(
                    f"swarm {config.name}: mission_options: drone {i}: {error.where}",
                    error.found,
                    error.allowed,
                    error.do,
                ) from error
        return []

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Report the length of the figure in m."""
        steps = np.diff(self._places(config, config.ids[0]), axis=0)
        return {"figure_m": float(np.sum(np.linalg.norm(steps, axis=1)))}

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the planned path (broad) and the flown path."""
        draw_plans(path, results, {i: self._places(config, i) for i in config.ids})

    def _places(self, config: SwarmConfig, i: int) -> Mat:
        """Return 500 places of the figure of drone i, (500, 3) m."""
        figure = self.figure(config, i)
        times = np.linspace(0.0, figure.duration, 500)
        return np.array([figure.sample(t).p for t in times])
