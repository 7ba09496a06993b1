"""Each drone flies a circle or an eight around its home, as exactly as it can.

crazychoir run figure --fast --drones 4 --picture out/figure.png
"""

from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta

from crazychoir import CFGuidance, SwarmConfig
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
from crazychoir.guidance.path_checks import require_inside
from crazychoir.planning import feasibility
from crazychoir.planning.feasibility import Limits
from crazychoir.planning.figure import Figure, circle, eight

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
Kind = Annotated[
    Literal["circle", "eight"],
    Meta(description='"circle" or "eight"', examples=["eight"]),
]
YawRate = Annotated[
    float, Meta(ge=-20, le=20, description="a rate in rad/s, -20 to 20", examples=[0.5])
]


class Options(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    figure: Kind = "circle"
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


class Flown(CFGuidance):
    """Flies one figure."""

    def __init__(self, home: tuple[float, float, float], options: Options) -> None:
        self.home = home
        self.options = options

    async def mission(self) -> dict[str, Any]:
        """Take off, go to the start of the figure, fly it, go home, land."""
        flight = figure(
            self.home, self.member.config.flight.takeoff_height, self.options
        )
        await self.take_off()
        await self.rendezvous()
        await self.fly(flight)
        await self.go_to((*self.home[:2], self.state.p[2]))
        await self.land()
        return {"place": self.state.p.tolist()}


def figure(home: tuple[float, float, float], height: float, options: Options) -> Figure:
    """Return the figure over a home, at `height` m above it."""
    center = (home[0], home[1], home[2] + height)
    size = options.size
    rest = (
        options.period,
        options.laps,
        options.ramp or None,
        options.yaw,
        options.yaw_rate,
    )
    return (
        circle(center, size, *rest)
        if options.figure == "circle"
        else eight(center, size, 0.5 * size, *rest)
    )


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the guidance of drone i: it flies around its home."""
    return Flown(config.drone(i).home, given(config, Options))


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check the options, and that each drone can fly its figure. Raises ConfigError if not."""
    where = f"swarm {config.name}: mission_options"
    given(config, Options)
    require_none(config)
    limits = Limits(
        v_max=config.flight.speed_limit,
        a_max=config.flight.acceleration_limit,
        low=config.fence.min,
        high=config.fence.max,
    )
    for i in config.ids:
        try:
            feasibility.check_limits(_figure(config, i), limits)
            require_inside(_figure(config, i), config, i, "trajectory")
        except ConfigError as error:
            raise ConfigError(
                f"{where}: drone {i}: {error.where}",
                error.found,
                error.allowed,
                error.do,
            ) from error
    return []


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Report the length of the figure in m."""
    path = _path(config, config.ids[0])
    return {"figure_m": float(np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1)))}


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the figures from above."""
    import matplotlib.pyplot as plt  # takes 1 s and a font cache: imported only for a picture

    shown, axes = plt.subplots(figsize=(3.5, 3.5))
    for i in config.ids:
        x, y, _ = _path(config, i).T
        axes.plot(x, y, label=f"drone {i}")
    axes.set(xlabel="x in m", ylabel="y in m", aspect="equal")
    axes.legend(fontsize=7)
    shown.savefig(path, dpi=200, bbox_inches="tight")
    plt.close(shown)


def _path(config: SwarmConfig, i: int) -> np.ndarray:
    flight = _figure(config, i)
    return np.array(
        [flight.sample(t).p for t in np.linspace(0.0, flight.duration, 500)]
    )


def _figure(config: SwarmConfig, i: int) -> Figure:
    return figure(
        config.drone(i).home, config.flight.takeoff_height, given(config, Options)
    )
