"""Commands that pages have given, and their receipts: who has acknowledged, who has done it, who says nothing."""

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from crazychoir.bus.commands import ACCEPTED, DONE, NOT_READY, REFUSED, Answer, Commander
from crazychoir.bus.local import BODIES
from crazychoir.dashboard.watch import Watch
from crazychoir.runtime.clock import Clock
from crazychoir.swarm.config import SwarmConfig

SENT, SILENT = "sent", "silent"
ACKNOWLEDGED = 2.0
"""s within which a drone says that it has heard a command; it is resent meanwhile, and goes on being."""
SECONDS = {
    "arm": 5.0, "take-off": 30.0, "start": 5.0, "hold": 5.0, "go": 5.0, "land": 60.0, "home": 120.0, "go-to": 120.0,
}  # fmt: skip
"""s to wait until each is done; others get REQUEST s."""
REQUEST, STOP, LOOK = 5.0, 10.0, 0.05
READY, RETRY = 15.0, 0.3
"""s for which a drone that is not ready yet is asked again, and between two times."""
KEPT = 50
"""Receipts."""


class Place(Protocol):
    """The place on the network from which commands are given."""

    clock: Clock
    config: SwarmConfig
    commander: Commander


@dataclass
class Receipt:
    """A command, and what each drone has said to it.

    number: counts from 1;  t: s, when it was given;  answers: by drone, (kind, words): SENT until it has acknowledged,
    then ACCEPTED, DONE or REFUSED, SILENT if it has not acknowledged in time;  version: counts changes of all receipts.
    """

    number: int
    verb: str
    words: str
    t: float
    answers: dict[int, tuple[str, Any]] = field(default_factory=dict)
    version: int = 0

    @property
    def open(self) -> bool:
        """Whether somebody may still answer."""
        return any(kind in (SENT, ACCEPTED) for kind, _ in self.answers.values())

    def done(self) -> bool:
        """Whether all have done it."""
        return bool(self.answers) and all(kind == DONE for kind, _ in self.answers.values())


class Desk:
    """Gives commands; nothing here waits for them: their receipts grow."""

    def __init__(self, place: Place, watch: Watch) -> None:
        self.place, self.watch = place, watch
        self.receipts: deque[Receipt] = deque(maxlen=KEPT)
        self.version = 0
        self._count = 0
        self._tasks: dict[asyncio.Task[None], None] = {}

    def after(self, version: int) -> list[Receipt]:
        """The receipts that have changed since then, oldest first."""
        return [receipt for receipt in self.receipts if receipt.version > version]

    def order(
        self, verb: str, drones: Iterable[int] | None = None, seconds: float | None = None, words: str = "",
        each: Callable[[int], Mapping[str, Any]] = lambda i: {},
    ) -> Receipt:  # fmt: skip
        """Command these drones, None: all; each: the arguments of each."""
        receipt = self._new(verb, self.place.config.ids if drones is None else drones, words)
        limit = SECONDS.get(verb, REQUEST) if seconds is None else seconds
        for i in receipt.answers:
            self._spawn(self._ask(receipt, i, verb, limit, each(i)))
        return receipt

    def stop(self, drones: Iterable[int] | None = None, clear: bool = False) -> Receipt:
        """Emergency stop of these drones, None: of the swarm, in force until it is cleared; or clear it."""
        config = self.place.config
        meant = list(config.ids if drones is None else drones)
        receipt = self._new("clear stop" if clear else "emergency stop", meant, "")
        self._spawn(self._stop(receipt, meant, clear, alone=drones is not None and not clear))
        return receipt

    async def settled(self, receipt: Receipt) -> Receipt:
        """Wait until nobody may answer any more."""
        while receipt.open:
            await self.place.clock.sleep(LOOK)
        return receipt

    def close(self) -> None:
        """Wait for nothing more."""
        for task in self._tasks:
            task.cancel()

    def _new(self, verb: str, drones: Iterable[int], words: str) -> Receipt:
        self._count += 1
        receipt = Receipt(self._count, verb, words, round(self.place.clock.now(), 2))
        receipt.answers = {i: (SENT, "") for i in drones}
        self.receipts.append(receipt)
        self._changed(receipt)
        return receipt

    def _spawn(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks[task] = None
        task.add_done_callback(lambda done: self._tasks.pop(done, None))

    def _changed(self, receipt: Receipt) -> None:
        self.version += 1
        receipt.version = self.version

    def _answer(self, receipt: Receipt, i: int, kind: str, words: Any = "") -> None:
        if receipt.answers[i] != (kind, words):
            receipt.answers[i] = kind, words
            self._changed(receipt)
            if kind in (REFUSED, SILENT):
                self.watch.add(f"{receipt.verb}: {kind}: {words}", "warning", i)

    async def _ask(self, receipt: Receipt, i: int, verb: str, seconds: float, arguments: Mapping[str, Any]) -> None:
        place = self.place
        timer = place.clock.call_at(
            place.clock.now_ns() + round(ACKNOWLEDGED * 1e9), self._unheard, receipt, i, drone=i
        )
        try:
            answer = await self._answered(receipt, i, verb, seconds, arguments)
        except TimeoutError:
            self._answer(receipt, i, SILENT, f"no answer within {seconds:g} s; is its agent running?")
            return
        finally:
            timer.cancel()
        if answer.kind == ACCEPTED:
            self._answer(receipt, i, REFUSED, f"not done within {seconds:g} s")
        else:
            self._answer(receipt, i, answer.kind, "" if answer.detail is None else answer.detail)

    async def _answered(
        self, receipt: Receipt, i: int, verb: str, seconds: float, arguments: Mapping[str, Any]
    ) -> Answer:  # fmt: skip
        """What it says at last; who is not ready yet is asked again, for at most READY s."""
        clock, commander = self.place.clock, self.place.commander
        began, asks = clock.now(), clock.now() + min(seconds, READY)
        while True:
            left = began + seconds - clock.now()
            answer = await commander.request(i, verb, left, lambda: self._answer(receipt, i, ACCEPTED), **arguments)
            waits = answer.kind == REFUSED and str(answer.detail).startswith(NOT_READY)
            if not waits or clock.now() + RETRY >= asks:
                return answer
            await clock.sleep(RETRY)

    def _unheard(self, receipt: Receipt, i: int) -> None:
        if receipt.answers[i][0] == SENT:
            self._answer(receipt, i, SENT, f"not acknowledged within {ACKNOWLEDGED:g} s; resent")

    async def _stop(self, receipt: Receipt, meant: list[int], clear: bool, alone: bool) -> None:
        """Agents and the bodies at owners; a drone has obeyed when both have."""
        place = self.place
        bodies = [i for i in place.config.elsewhere if i in meant]
        obeyed: dict[int, None] = {}
        targets = [*meant, *(BODIES + i for i in bodies)]
        order = place.commander.emergency_stop(targets, clear, STOP, alone, obeyed)
        sending = asyncio.ensure_future(order)
        try:
            while not sending.done():
                self._tell_obeyed(receipt, bodies, obeyed, clear)
                await place.clock.sleep(LOOK)
            self._tell_obeyed(receipt, bodies, obeyed, clear)
        finally:
            sending.cancel()
        for i, (kind, _) in receipt.answers.items():
            if kind != DONE:
                body = "; its body has obeyed" if BODIES + i in obeyed else ""
                self._answer(receipt, i, SILENT, f"no acknowledgement within {STOP:g} s{body}")

    def _tell_obeyed(self, receipt: Receipt, bodies: list[int], obeyed: Mapping[int, None], clear: bool) -> None:
        for i in receipt.answers:
            if i in obeyed and (i not in bodies or BODIES + i in obeyed):
                self._answer(receipt, i, DONE, "cleared" if clear else "motors off")
