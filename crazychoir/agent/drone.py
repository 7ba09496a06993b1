"""One drone of a process: its parts, and how it is."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from crazychoir.bus.port import Port
from crazychoir.bus.presence import Presence
from crazychoir.flight.pilot import Pilot
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.sensors import Sensors
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.safety.rules.modes import HELD
from crazychoir.team.barrier import Barrier
from crazychoir.team.communicator import Communicator
from crazychoir.types import Status

UNFIT = "not ready to fly"
"""The task of a drone that a radio reaches, until it could fly."""
WAITING = "waiting for the others"
"""The task of a drone before GO."""


@dataclass
class Drone:
    """The parts of one drone."""

    id: int
    port: Port
    barrier: Barrier
    communicator: Communicator
    pilot: Pilot
    guidance: CFGuidance
    supervisor: Supervisor
    harm: Callable[[], str] = str
    """Says what has happened to its body; empty if nothing has, or nobody knows."""
    sensors: Sensors | None = None
    unfit: Callable[[], list[str]] = list
    """Says why it could not take off now; it joins the team when nothing is said."""
    result: dict[str, Any] = field(default_factory=dict)
    waits: str = ""
    """What it waits for now that its mission is over."""

    @property
    def _task_before(self) -> str:
        """Its task while its mission has said none."""
        if self.barrier.roster is not None:
            return ""
        return UNFIT if self.barrier.monitor.silent or self.barrier.refused else WAITING

    def status(self) -> Status:
        """What others see of it."""
        counters = self.port.counters
        monitor = self.barrier.monitor
        offsets = self.port.bus.offsets
        news = self.guidance.member.report() if hasattr(self.guidance, "member") else {}
        cost, relaxed = (
            float("nan") if (x := news.get(name)) is None else float(x)
            for name in ("cost", "relaxed")
        )
        notes = (HELD if self.pilot.held else "", self.pilot.note, self.barrier.apart)
        return Status(
            phase=self.pilot.mode.value,
            task=str(news.get("task", self._task_before)),
            round=int(news.get("round", self.communicator.rounds)),
            cost=cost,
            relaxed=relaxed,
            sent=counters.sent,
            lost=counters.lost,
            resent=counters.resent,
            dropped=counters.malformed + self.communicator.ahead,
            suspect=monitor.those(Presence.SUSPECT),
            gone=monitor.those(Presence.LOST),
            process=self.port.bus.process,
            host=self.port.bus.host,
            note=self.waits or "; ".join(text for text in notes if text),
            stopped=self.port.bus.stopped,
            grave=self.pilot.grave and not self.waits,
            hosts=list(offsets),
            offsets=[found.offset for found in offsets.values()],
            offset_errors=[found.error for found in offsets.values()],
        )
