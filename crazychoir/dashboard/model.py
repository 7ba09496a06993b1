"""The page's knowledge of a swarm: the newest message of each topic of each drone."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS, Topic
from crazychoir.config.checks import limit_area
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.dashboard.event_log import EventLog
from crazychoir.dashboard.recent_loss import RecentCounts, lost_share
from crazychoir.runtime.mailbox import Call
from crazychoir.types import FullState, LinkStatus, State, Status, Vec


@dataclass(frozen=True, slots=True)
class PageDataLimits:
    """Rates at which the page receives data, and how long it counts."""

    state_rate: float = 30.0
    """Hz: rate of the states, and of the frames of a page."""
    reference_rate: float = 10.0
    """Hz: rate of the references."""
    link_rate: float = 4.0
    """Hz: rate of the states of radio links."""
    loss_window: float = 5.0
    """Seconds over which a share of lost messages is taken."""
    status_timeout: float = 2.0
    """Seconds without a status after which a drone counts as not heard."""
    most_rounds: int = 240
    """Number of rounds in the curves of costs."""


PAGE_DATA = PageDataLimits()


LINK_STATUS_TIMEOUT = DRONE_TOPICS.link.max_age + 1.0 / PAGE_DATA.link_rate
"""Seconds after which the last message about a radio link is too old to be used."""
FRAME_COLUMNS = 17
"""Numbers in a row of a frame: p, v, q, w as in State, the age in s, p of the reference."""
AGE_COLUMN = 13
"""Column of the age."""
REFERENCE_COLUMNS = slice(14, 17)
"""Columns of the reference position."""


@dataclass
class LastMessages:
    """The last messages of one drone."""

    status: Status | None = None
    """Its last status."""
    heard: float = -math.inf
    """s, when the last status was sent."""
    link: LinkStatus | None = None
    """The last state of its radio link."""
    linked: float = -math.inf
    """s, when the link was in that state."""
    result: dict[str, Any] | None = None
    """Result of its mission."""
    lately: RecentCounts = field(
        default_factory=lambda: RecentCounts(PAGE_DATA.loss_window)
    )
    """Recent counts of its messages to other drones."""


class SwarmModel:
    """Listens to all drones of a swarm file.

    The drones have no additional work: it only subscribes to messages that they send anyway.

    bus, address: where it listens
    config: the swarm file
    watch: log of what the drones do
    console: log of the lines of their firmware; None for the same log
    """

    def __init__(
        self,
        bus: Bus,
        address: int,
        config: SwarmConfig,
        watch: EventLog,
        console: EventLog | None = None,
    ) -> None:
        self.bus = bus
        self.address = address
        self.config = config
        self.watch = watch
        self.console = console or watch
        self.drones = {i: LastMessages() for i in config.ids}
        self._plans: dict[
            int, dict[int, tuple[float, float]]
        ] = {}  # by round and drone: its cost and the value of its relaxation
        self._rows = np.full((len(config.ids), FRAME_COLUMNS), np.nan, dtype="<f4")
        self._seen = np.full(len(config.ids), -np.inf)
        self._wanted = np.full(len(config.ids), -np.inf)
        for k, i in enumerate(config.ids):
            self._read(
                DRONE_TOPICS.state,
                i,
                partial(self._hear_state, k),
                PAGE_DATA.state_rate,
            )
            self._read(
                DRONE_TOPICS.reference,
                i,
                partial(self._hear_reference, k),
                PAGE_DATA.reference_rate,
            )
            self._read(DRONE_TOPICS.status, i, partial(self._hear_status, i))
            self._read(
                DRONE_TOPICS.link, i, partial(self._hear_link, i), PAGE_DATA.link_rate
            )
            self._read(DRONE_TOPICS.result, i, partial(self._hear_result, i))
            self._read(DRONE_TOPICS.log, i, partial(self._hear_log, i))
            self._read(DRONE_TOPICS.console, i, partial(self._hear_console, i))

    def _read(
        self,
        topic: Topic,
        i: int,
        function: Callable[[Any, float], None],
        rate: float = 0.0,
    ) -> None:
        box = Call(self.bus.clock, function, f"page {topic.name} of {i}")
        self.bus.subscribe(
            topic, self.config.topology.source(topic, i), self.address, box, rate
        )

    # Receiving ----------------------------------------------------------------------------

    def _hear_state(self, k: int, state: State, age: float) -> None:
        self._rows[k, 0:13] = state.flat
        self._seen[k] = self.bus.clock.now() - max(age, state.age)

    def _hear_reference(self, k: int, reference: FullState, age: float) -> None:
        self._rows[k, REFERENCE_COLUMNS] = reference.p
        self._wanted[k] = self.bus.clock.now() - age

    def _hear_status(self, i: int, status: Status, age: float) -> None:
        seen = self.drones[i]
        now = self.bus.clock.now()
        before = seen.status
        seen.status = status
        seen.heard = now - age
        seen.lately.note(now, status.sent, status.lost)
        if before is None or before.phase != status.phase:
            self.watch.add(status.phase, "info", i)
        if status.note and (before is None or before.note != status.note):
            self.watch.told(i, status.note, status.grave)
        if before is not None and status.sent < before.sent:  # the agent was restarted
            self._plans = {
                k: rest
                for k, of in self._plans.items()
                if (rest := {j: of[j] for j in of if j != i})
            }
        if math.isfinite(status.cost):
            self._plans.setdefault(status.round, {})[i] = status.cost, status.relaxed
            if len(self._plans) > PAGE_DATA.most_rounds:
                del self._plans[min(self._plans)]

    def _hear_link(self, i: int, link: LinkStatus, age: float) -> None:
        self.drones[i].link, self.drones[i].linked = link, self.bus.clock.now() - age

    def _hear_result(self, i: int, result: dict[str, Any], age: float) -> None:
        self.drones[i].result = result
        good = bool(result.get("success"))
        self.watch.add(
            f"mission ended: {'success' if good else result.get('reason', 'no success')}",
            "info" if good else "error",
            i,
        )

    def _hear_log(self, i: int, line: str, age: float) -> None:
        self.watch.told(i, line)

    def _hear_console(self, i: int, line: str, age: float) -> None:
        self.console.add(line.removeprefix(f"drone {i}: "), "info", i)

    # Reporting ----------------------------------------------------------------------------

    def position(self, i: int) -> Vec | None:
        """Return the last position of drone i, (3,) m, world; None if it was not heard."""
        k = self.config.ids.index(i)
        return None if self._seen[k] == -np.inf else self._rows[k, 0:3].astype(float)

    def state(self, i: int) -> tuple[State, float] | None:
        """Return the last state of drone i and its age in s; None if it was not heard."""
        k = self.config.ids.index(i)
        if self._seen[k] == -np.inf:
            return None
        age = self.bus.clock.now() - float(self._seen[k])
        return State(self._rows[k, 0:13].astype(float)), age

    def heard_by(self, i: int) -> int:
        """Return how many drones drone i hears, itself included; 0 if i is not heard here."""
        seen = self.drones[i]
        if (
            seen.status is None
            or self.bus.clock.now() - seen.heard > PAGE_DATA.status_timeout
        ):
            return 0
        return len(self.config.ids) - len(seen.status.suspect) - len(seen.status.gone)

    def frame(self) -> bytes:
        """Return the states of all drones as bytes.

        The time in s by this clock (float64), then a row of FRAME_COLUMNS float32 for each drone,
        little-endian. NaN: not heard, or no reference.
        """
        now = self.bus.clock.now()
        rows = self._rows
        rows[:, AGE_COLUMN] = now - self._seen
        rows[now - self._wanted > DRONE_TOPICS.reference.max_age, REFERENCE_COLUMNS] = (
            np.nan
        )
        return np.float64(now).tobytes() + rows.tobytes()

    def about(self) -> dict[str, Any]:
        """Return the data that do not change: drones, edges, the room."""
        config = self.config
        low, high = limit_area(config)
        return {
            "swarm": config.name,
            "mission": config.mission,
            "ids": list(config.ids),
            "names": {
                str(i): f"{i} {config.drone(i).name}".rstrip() for i in config.ids
            },
            "rate": PAGE_DATA.state_rate,
            "edges": sorted({(min(arc), max(arc)) for arc in config.graph().arcs}),
            "fence": [list(config.fence.min), list(config.fence.max)],
            "limit": [list(low), list(high)],
            "ground": config.flight.ground,
            "columns": FRAME_COLUMNS,
            "leaders": [drone.id for drone in config.drones if drone.leader],
            "speed_limit": config.flight.speed_limit,
            "acceleration_limit": config.flight.acceleration_limit,
            "height": config.flight.ground + config.flight.takeoff_height,
        }

    def costs(self) -> list[tuple[int, float, float]]:
        """Return (round, mean cost, mean relaxation) over the drones, for each round.

        A mean is NaN if no drone has a finite value. While a drone plans, its relaxation covers
        only the routes that it knows by then, so it is not a bound.
        """
        of = {k: list(self._plans[k].values()) for k in sorted(self._plans)}
        return [
            (
                k,
                _mean_of_finite(cost for cost, _ in told),
                _mean_of_finite(relaxed for _, relaxed in told),
            )
            for k, told in of.items()
        ]

    def table(self) -> list[dict[str, Any]]:
        """Return a row for each drone: its state and its radio link; unknown values are None."""
        return [self._row(k, i) for k, i in enumerate(self.config.ids)]

    def _row(self, k: int, i: int) -> dict[str, Any]:
        seen = self.drones[i]
        now = self.bus.clock.now()
        status = seen.status or Status("")
        row: dict[str, Any] = {
            "id": i,
            "heard": now - seen.heard < PAGE_DATA.status_timeout,
            "phase": status.phase,
            "task": status.task,
            "stopped": status.stopped,
            "round": status.round,
            "cost": _round_finite(status.cost),
            "lost": round(lost_share(seen.lately), 3),
            "process": status.process,
            "host": status.host,
            "note": status.note,
            "suspect": status.suspect,
            "gone": status.gone,
            "age": _round_finite(float(now - self._seen[k]), 2),
        }
        return (
            row
            if seen.link is None
            else row | _link_state(seen.link, now - seen.linked)
        )


def _link_state(link: LinkStatus, age: float) -> dict[str, Any]:
    """Return the state of a drone's radio link, `age` s old.

    If it is too old, return only for how long the link has been silent.
    """
    if age > LINK_STATUS_TIMEOUT:
        return {"link": "silent", "silent": round(age, 1)}
    return {
        "link": link.state,
        "latency": _round_finite(link.latency, 4),
        "answered": _round_finite(link.answered, 3),
        "rssi": _round_finite(link.rssi, 0),
        "battery": _round_finite(link.battery, 2),
    }


def _mean_of_finite(x: Iterable[float]) -> float:
    """Return the mean of the finite values, NaN if there are none."""
    known = [value for value in x if math.isfinite(value)]
    return float(np.mean(known)) if known else math.nan


def _round_finite(value: float, digits: int = 3) -> float | None:
    """Return the rounded value, None if it is not finite."""
    return round(value, digits) if math.isfinite(value) else None
