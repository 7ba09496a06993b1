"""Tracking errors of a drone on a path: controllers alone with two plants, and the whole stack."""

import asyncio
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any, Literal

import numpy as np
from rich.table import Table

from crazychoir.agent.agent import Agent
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.attitude import GeometryAttitudeCtrl
from crazychoir.control.choice import Controls, make_controls
from crazychoir.control.controller import HierarchicalController
from crazychoir.control.gains import Gains
from crazychoir.control.margin import Plant
from crazychoir.control.position import FlatnessPositionCtrl
from crazychoir.guidance.mission import load_mission
from crazychoir.planning.figure import Figure, circle, eight
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.runtime.mailbox import Call
from crazychoir.simulation.engines import make_worlds
from crazychoir.types import Command, FullState, State, Vec


@dataclass(frozen=True, slots=True)
class TrackingBenchSettings:
    """Settings of `crazychoir bench tracking`: the times of a flight, and its limits."""

    tick_period: float = 0.01
    """Period of the control law, s."""
    settling_time: float = 4.0
    """Seconds at full speed that do not count."""
    counted_time: float = 20.0
    """Seconds that count."""
    ramp_time: float = 4.0
    """Seconds from rest to full speed."""
    command_delay: float = 0.02
    """Delay of a command at the motor level, s."""
    lost_distance: float = 1.0
    """Distance from the reference at which the drone counts as lost, m."""


TRACKING_BENCH = TrackingBenchSettings()


NOMINAL_CORNER = "nominal"
TYPICAL_CORNER = "typical drone"
TRACKING_URIS = {"lightweight": "sim://", "motors": "sim://motors"}
CAMERA_ERRORS = {
    "noise": 0.0005,
    "noise_angle": math.radians(0.25),
    "latency": 0.01,
    "tilt_spread": 0.0,
}
"""Errors of the cameras: m, rad, s."""

Say = Callable[[str], None]
Errors = list[Vec]
Path = Literal["circle", "eight-1", "eight-2"]
TRACKING_PATHS: tuple[Path, ...] = ("circle", "eight-1", "eight-2")


@dataclass(frozen=True)
class ModelCorner:
    """A drone that differs from the model of its controllers."""

    thrust: float
    """Relative error of its thrust."""
    mass: float
    """Relative error of its mass."""
    tilt: tuple[float, float]
    """Error of its attitude in the cameras: roll and pitch, deg."""

    @property
    def name(self) -> str:
        """The corner in words."""
        axis, angle = (
            ("roll", self.tilt[0]) if self.tilt[0] else ("pitch", self.tilt[1])
        )
        return (
            f"thrust {self.thrust:+.0%}, mass {self.mass:+.0%}, {axis} {angle:+g} deg"
        )


MODEL_CORNERS = [
    ModelCorner(*c)
    for c in product((-0.05, 0.05), (-0.03, 0.03), ((1, 0), (-1, 0), (0, 1), (0, -1)))
]


@dataclass(frozen=True)
class TrackingRow:
    """One row of the table."""

    plant: str
    path: str
    controller: str
    corner: str
    rmse_mm: float | None
    """Root mean square distance from the reference, mm; None if the drone was lost."""
    peak_mm: float | None
    """Largest distance from the reference, mm; None if the drone was lost."""


def tracking_row(
    plant: str, name: str, controller: str, corner: str, errors: Errors | None
) -> TrackingRow:
    """Return a row with the root mean square and the largest distance from the reference."""
    if not errors:
        return TrackingRow(plant, name, controller, corner, None, None)
    distances = 1e3 * np.linalg.norm(errors, axis=1)
    return TrackingRow(
        plant,
        name,
        controller,
        corner,
        float(np.sqrt(np.mean(distances**2))),
        float(distances.max()),
    )


def figure_options(name: Path) -> dict[str, Any]:
    """Return the options of the mission `figure` for a path.

    The circle has a radius of 0.4 m and takes 40 s. The eight measures 2 m by 1 m, with a peak
    speed of 1 or 2 m/s.
    """
    period = (
        40.0 if name == "circle" else 2.0 * math.pi * math.sqrt(2.0) / float(name[-1])
    )
    kind, size = ("circle", 0.4) if name == "circle" else ("eight", 1.0)
    return {
        "figure": kind,
        "size": size,
        "period": period,
        "laps": (
            TRACKING_BENCH.ramp_time
            + TRACKING_BENCH.settling_time
            + TRACKING_BENCH.counted_time
        )
        / period,
        "ramp": TRACKING_BENCH.ramp_time,
    }


def path_trajectory(name: Path) -> Figure:
    """Return the path as a trajectory around (0, 0, 1)."""
    chosen = figure_options(name)
    size = chosen.pop("size")
    kind = chosen.pop("figure")
    center = (0.0, 0.0, 1.0)
    return (
        circle(center, size, **chosen)
        if kind == "circle"
        else eight(center, (size, 0.5 * size), **chosen)
    )


def is_counted(t: float) -> bool:
    """Return whether the drone is at full speed and settled at t s of a path."""
    return (
        TRACKING_BENCH.ramp_time + TRACKING_BENCH.settling_time
        <= t
        <= TRACKING_BENCH.ramp_time
        + TRACKING_BENCH.settling_time
        + TRACKING_BENCH.counted_time
    )


def tracking_swarm(
    plant: Plant,
    name: Path,
    home: tuple[float, float, float],
    corner: ModelCorner | None = None,
    imperfections: float = 0.0,
) -> SwarmConfig:
    """Return one Crazyflie 2.1 with the mission `figure`, in still air.

    plant: simulated engine
    name: path
    home: (3,) m, world
    corner: errors of its model, None for none
    imperfections: 0 for a perfect drone, 1 for a typical one
    """
    exact = {
        "command_delay": TRACKING_BENCH.command_delay if plant == "motors" else 0.0,
        "rate_lag": 0.0,
    }
    off = (
        {}
        if corner is None
        else {"thrust_error": corner.thrust, "mass_error": corner.mass}
    )
    tilt = (
        {}
        if corner is None
        else {"tilt": [math.radians(angle) for angle in corner.tilt]}
    )
    return SwarmConfig.of(
        {
            "name": "tracking",
            "mission": "figure",
            "mission_options": figure_options(name),
            "graph": "empty",
            "drones": [
                {"id": 0, "home": home, "uri": TRACKING_URIS[plant], "platform": "cf21"}
            ],
            "flight": {"speed_limit": 2.5, "acceleration_limit": 5.0},
            "mocap": {**CAMERA_ERRORS, **tilt},
            "motors": {"imperfections": imperfections},
            "plant": {**exact, **off},
        }
    )


# The controllers alone: they see the truth, each tick of 10 ms ----------------------------------------------------


def fly_controllers(plant: Plant, name: Path, chosen: Controls) -> Errors | None:
    """Return the errors of a flight with controllers that see the true state; None if it is lost.

    They are counted from the start of the path. A lightweight drone obeys at once, a drone at the
    motor level TRACKING_BENCH.command_delay s later.
    """
    figure = path_trajectory(name)
    [world] = make_worlds(
        tracking_swarm(plant, name, tuple(figure.sample(0.0).p.tolist())), (0,)
    )
    late = (
        round(TRACKING_BENCH.command_delay / TRACKING_BENCH.tick_period)
        if plant == "motors"
        else 0
    )
    link = world.link(0, chosen.sender.kind)
    way = deque[Command]()
    errors = []
    chosen.trim.frozen = False
    for k in range(round(figure.duration / TRACKING_BENCH.tick_period)):
        t = k * TRACKING_BENCH.tick_period
        reference = figure.sample(t)
        error = world.states[0, :3] - reference.p
        if not np.linalg.norm(error) < TRACKING_BENCH.lost_distance:
            return None
        if is_counted(t):
            errors.append(error)
        command = chosen.tracker.command(State(world.states[0].copy()), reference, t)
        assert command is not None  # noqa: S101 - every tick has one
        way.append(command)
        if len(way) > late:
            link.send(way.popleft())
        world.step()
    return errors


def original_controller(plant: Plant) -> Controls:
    """Return the flatness controller with the gains of CrazyChoir's Webots simulation.

    It has no early feed-forward and learns nothing.
    """
    m = 0.038
    gains = Gains(
        (0.4 / m, 0.4 / m, 1.25 / m), (0.2 / m, 0.2 / m, 0.4 / m), (16.0, 16.0, 0.2)
    )
    chosen = make_controls(platform=CRAZYFLIE_21, plant=plant)
    assert isinstance(chosen.tracker, HierarchicalController)  # noqa: S101 - it sends fpqr
    chosen.tracker.pos_strategy = FlatnessPositionCtrl(gains, CRAZYFLIE_21)
    chosen.tracker.attitude_strategy = GeometryAttitudeCtrl(gains, CRAZYFLIE_21)
    return chosen


def standard_controllers(plant: Plant) -> Controls:
    """Return the standard controllers."""
    return make_controls(
        platform=CRAZYFLIE_21,
        plant=plant,
        rate_lag=0.0,
        command_delay=TRACKING_BENCH.command_delay if plant == "motors" else 0.0,
    )


# The whole stack: cameras, filter, pilot, controllers, firmware, rotors, in virtual time -----------------------------


def fly_whole_stack(
    name: Path, corner: ModelCorner | None = None, imperfections: float = 0.0
) -> Errors | None:
    """Return the errors of the mission `figure` flown by an agent.

    None if the drone is lost, or if it has not flown all the time that counts.
    imperfections: 0 for a perfect drone, 1 for a typical one
    """
    config = tracking_swarm("motors", name, (0.0, 0.0, 0.0), corner, imperfections)

    async def main(clock: Clock) -> Errors | None:
        agent = Agent(clock, config, load_mission("figure"), config.ids)
        meter = TrackingMeter(agent)
        agent.services.append(meter)
        results = await agent.run()
        flown = results[0].get("success", True) and not agent.owners[0].world.crashed
        return (
            meter.errors
            if flown
            and len(meter.errors)
            >= 0.99 * TRACKING_BENCH.counted_time / TRACKING_BENCH.tick_period
            else None
        )

    return run_virtual(main)


class TrackingMeter(Actor):
    """Compares the true place with the reference at each tick in which drone 0 flies its figure."""

    name = "meter"

    def __init__(self, agent: Agent) -> None:
        self.clock = agent.clock
        self.pilot = agent.drones[0].pilot
        self.world = agent.owners[0].world
        self.errors: Errors = []
        agent.bus.subscribe(
            DRONE_TOPICS.reference, 0, 0, Call(agent.clock, self._flown)
        )

    async def run(self) -> None:
        """Wait for ever: the subscription to references does the work."""
        await asyncio.get_running_loop().create_future()

    def _flown(self, reference: FullState, age: float) -> None:
        flights = self.pilot.flights
        if isinstance(flights.plan, Figure) and is_counted(
            self.clock.now() - flights.start
        ):
            self.errors.append(self.world.states[0, :3] - reference.p)


# The table ---------------------------------------------------------------------------------------------------------


def run(quick: bool = False, say: Say = lambda line: None) -> dict[str, Any]:
    """Return {"rows": [...]}, each {plant, path, controller, corner, rmse_mm, peak_mm}.

    rmse_mm is None if the drone was lost.
    """
    return {"rows": [asdict(row) for row in _rows(quick, say)]}


def _rows(quick: bool, say: Say) -> Iterator[TrackingRow]:
    plants: tuple[tuple[Plant, str], ...] = (
        ("lightweight", "lightweight"),
        ("motors", "motor"),
    )
    for plant, title in plants:
        for name in TRACKING_PATHS:
            say(f"{title}, {name}")
            yield tracking_row(
                title,
                name,
                "standard",
                NOMINAL_CORNER,
                fly_controllers(plant, name, standard_controllers(plant)),
            )
            yield tracking_row(
                title,
                name,
                "original's gains",
                NOMINAL_CORNER,
                fly_controllers(plant, name, original_controller(plant)),
            )
    for name in TRACKING_PATHS:
        say(f"whole stack, {name}")
        yield tracking_row(
            "full", name, "standard", NOMINAL_CORNER, fly_whole_stack(name)
        )
    for name in TRACKING_PATHS:
        say(f"whole stack, typical drone, {name}")
        yield tracking_row(
            "full",
            name,
            "standard",
            TYPICAL_CORNER,
            fly_whole_stack(name, imperfections=1.0),
        )
    for corner in MODEL_CORNERS[:2] if quick else MODEL_CORNERS:
        say(f"whole stack, eight-1, {corner.name}")
        yield tracking_row(
            "full",
            "eight-1",
            "standard",
            corner.name,
            fly_whole_stack("eight-1", corner),
        )


def table(result: dict[str, Any]) -> Table:
    """Return the rows as a table."""
    shown = Table(title="Distance from the reference, mm, at full speed after 4 s")
    for name in ("plant", "path", "controller", "corner", "RMS", "largest"):
        shown.add_column(
            name, justify="right" if name in ("RMS", "largest") else "left"
        )
    for row in result["rows"]:
        figures = (
            ("lost", "")
            if row["rmse_mm"] is None
            else (f"{row['rmse_mm']:.2f}", f"{row['peak_mm']:.2f}")
        )
        shown.add_row(
            row["plant"], row["path"], row["controller"], row["corner"], *figures
        )
    return shown
