"""One drone of a process: its parts, and its status."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from crazychoir.bus.port import Port
from crazychoir.bus.presence import Presence
from crazychoir.flight.pilot import Pilot
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.sensors import Sensors
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.safety.rules.modes import HELD_TEXT
from crazychoir.safety.rules.radio_watch import RadioWatch
from crazychoir.simulation.remote import RemoteLink
from crazychoir.team.barrier import Barrier
from crazychoir.team.communicator import Communicator
from crazychoir.types import Status

UNFIT_TASK = "not ready to fly"
"""Task of a drone with a radio that is not ready to fly yet."""
WAITING_TASK = "waiting for the others"
"""Task of a drone before GO."""


@dataclass
class Drone:
    """The parts of one drone."""

    id: int
    """Id of the drone."""
    port: Port
    """Its port on the bus."""
    barrier: Barrier
    """Start of the team, and changes of the team."""
    communicator: Communicator
    """Its link to the neighbours."""
    pilot: Pilot
    """Its pilot."""
    guidance: CFGuidance
    """Its mission."""
    supervisor: Supervisor
    """Runs its actors."""
    remote: RemoteLink | None = None
    """Link to its body in another process. None: the body is in this process."""
    radio_watch: RadioWatch | None = None
    """Watches its radio. None: it has none."""
    harm: Callable[[], str] = str
    """Returns the damage of its body. Empty if it has none, or if the damage is not known."""
    sensors: Sensors | None = None
    """Readings of its sensors. None: it has none."""
    unfit: Callable[[], list[str]] = list
    """Returns why it could not take off now. It joins the team when the list is empty."""
    result: dict[str, Any] = field(default_factory=dict)
    """Its part of the result."""
    waits: str = ""
    """What it waits for after its mission. Empty: nothing."""

    @property
    def _task_before(self) -> str:
        """Task of the drone before its mission reports one."""
        if self.barrier.roster is not None:
            return ""
        return (
            UNFIT_TASK
            if self.barrier.monitor.silent or self.barrier.refused
            else WAITING_TASK
        )

    def status(self) -> Status:
        """Return the status that the others see."""
        counters = self.port.counters
        monitor = self.barrier.monitor
        offsets = self.port.bus.offsets
        news = self.guidance.member.report() if hasattr(self.guidance, "member") else {}
        cost = news.get("cost")
        relaxed = news.get("relaxed")
        notes = [
            HELD_TEXT if self.pilot.permission.held else "",
            self.pilot.notes.text,
            self.barrier.apart,
        ]
        return Status(
            phase=self.pilot.mode.value,
            task=str(news["task"]) if "task" in news else self._task_before,
            round=int(news.get("round", self.communicator.rounds)),
            cost=math.nan if cost is None else float(cost),
            relaxed=math.nan if relaxed is None else float(relaxed),
            sent=counters.sent,
            lost=counters.lost,
            resent=counters.resent,
            dropped=counters.malformed + self.communicator.ahead,
            suspect=monitor.those(Presence.SUSPECT),
            gone=monitor.those(Presence.LOST),
            process=self.port.bus.process,
            host=self.port.bus.host,
            note=self.waits or "; ".join(filter(None, notes)),
            stopped=self.port.bus.stopped,
            grave=self.pilot.notes.is_grave and not self.waits,
            hosts=list(offsets),
            offsets=[found.offset for found in offsets.values()],
            offset_errors=[found.error for found in offsets.values()],
            link_faults=self.port.bus.link_faults,
        )
