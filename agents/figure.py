"""Each drone flies a circle or an eight around its home, as exactly as it can.

crazychoir run figure --fast --drones 4 --picture out/figure.png

[mission_options]: figure = "circle" | "eight";  size: m, the radius, or half the width of the eight;  period: s of a
lap at full speed;  laps;  ramp: s from rest to full speed, 0 for half a period;  yaw: rad at first;  yaw_rate: rad/s.
"""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.planning import feasibility
from crazychoir.planning.feasibility import Limits
from crazychoir.planning.figure import Figure, circle, eight

Results = dict[int, dict[str, Any]]
DEFAULTS: dict[str, Any] = {
    "figure": "circle", "size": 0.4, "period": 10.0, "laps": 2.0, "ramp": 0.0, "yaw": 0.0, "yaw_rate": 0.0,
}  # fmt: skip


class Flown(CFGuidance):
    """Flies one figure."""

    def __init__(self, home: tuple[float, float, float], options: dict[str, Any]) -> None:
        self.home, self.options = home, options

    async def mission(self) -> dict[str, Any]:
        """Up, to the start of the figure, along it, home, down."""
        flight = figure(self.home, self.member.config.flight.takeoff_height, self.options)
        await self.take_off()
        await self.rendezvous()
        await self.fly(flight)
        await self.go_to((*self.home[:2], self.state.p[2]))
        await self.land()
        return {"place": self.state.p.tolist()}


def figure(home: tuple[float, float, float], height: float, options: dict[str, Any]) -> Figure:
    """The figure over a home, at a height m above it."""
    chosen = DEFAULTS | options
    center = (home[0], home[1], home[2] + height)
    size, rest = chosen["size"], {key: chosen[key] for key in ("period", "laps", "yaw", "yaw_rate")}
    rest["ramp"] = chosen["ramp"] or None
    if chosen["figure"] == "circle":
        return circle(center, size, **rest)
    return eight(center, size, 0.5 * size, **rest)


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Drone i flies around its home."""
    return Flown(config.drone(i).home, config.mission_options)


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """The options are those that there are, and each drone can fly its figure."""
    where = f"swarm {config.name}: mission_options"
    for key, value in config.mission_options.items():
        if key not in DEFAULTS:
            raise ConfigError(f"{where}.{key}", value, f"one of {', '.join(DEFAULTS)}")
        if key == "figure" and value not in ("circle", "eight"):
            raise ConfigError(f"{where}.figure", value, '"circle" or "eight"')
        if key != "figure" and not isinstance(value, int | float) and (key, value) != ("yaw", "along"):
            raise ConfigError(f"{where}.{key}", value, "a number")
    limits = Limits(
        v_max=config.flight.speed_limit, a_max=config.flight.acceleration_limit,
        low=config.fence.min, high=config.fence.max,
    )  # fmt: skip
    for i in config.ids:
        try:
            feasibility.check(_figure(config, i), limits)
        except ConfigError as error:
            raise ConfigError(f"{where}: drone {i}: {error.where}", error.found, error.allowed, error.do) from error
    return []


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """How long the figure is, and its largest speed."""
    path = _path(config, config.ids[0])
    return {"figure_m": float(np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1)))}


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """The figures from above."""
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
    return np.array([flight.sample(t).p for t in np.linspace(0.0, flight.duration, 500)])


def _figure(config: SwarmConfig, i: int) -> Figure:
    return figure(config.drone(i).home, config.flight.takeoff_height, config.mission_options)
