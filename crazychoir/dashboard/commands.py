"""Commands that pages have given, and their receipts: who has acknowledged, who has done it, who says nothing."""

import asyncio
import math
from collections import deque
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from crazychoir.bus.commands import (
    ACCEPTED,
    DONE,
    NOT_READY,
    REFUSED,
    Answer,
    Commander,
)
from crazychoir.bus.port import BODIES
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.dashboard.event_log import Watch
from crazychoir.errors import CrazyChoirError, error_text
from crazychoir.runtime.clock import Clock

SENT, SILENT, UNFINISHED, WITHDRAWN = "sent", "silent", "unfinished", "withdrawn"
"""Beside those of an answer; UNFINISHED: it has accepted it, and may do it yet; WITHDRAWN: by a later order."""
ABSENT = "no agent of it is there"
REPLAYED = "REPLAY: nobody obeys"
ENDED = "ENDED: no drone is there"
ACKNOWLEDGED = 2.0
"""s within which a drone says that it has heard a command; it is resent meanwhile, and goes on being."""
SECONDS = {
    "arm": 5.0,
    "take-off": 30.0,
    "start": 5.0,
    "hold": 5.0,
    "go": 5.0,
    "land": 60.0,
    "home": 120.0,
    "go-to": 120.0,
}
"""s to wait until each is done; others get REQUEST s."""
MOTION = (*SECONDS, "fly")
"""Orders that move a drone, or let it move: a stop of it withdraws them."""
BESIDE = {
    "arm": MOTION,
    "take-off": ("arm", "start", "go"),
    "start": ("arm", "take-off", "hold", "go"),
    "go": ("arm", "take-off", "start"),
    "go-to": ("take-off", "hold"),
    "fly": ("take-off", "hold"),
}
"""By order: the older ones that still count beside it; it withdraws all others that nobody has acknowledged yet."""
IN_TURN = "impair"
"""Of these, a drone is asked for the next once it has answered to the one before: some add up, some do not."""
REQUEST, STOP, LOOK = 5.0, 10.0, 0.05
"""s to wait for what is no motion; after which who has not acknowledged a stop is called silent; between two looks."""
READY, RETRY = 15.0, 0.3
"""s for which a drone that is not ready yet is asked again, and between two times."""
KEPT = 50
"""Receipts."""


class Place(Protocol):
    """The place on the network from which commands are given."""

    clock: Clock
    config: SwarmConfig
    commander: Commander

    def is_there(self, i: int) -> bool:
        """Whether anybody answers for drone i."""
        ...

    @property
    def replays(self) -> bool:
        """Whether what is heard is a recording."""
        ...


@dataclass
class Receipt:
    """A command, and what each drone has said to it.

    number: counts from 1;  t: s, when it was given;  answers: by drone, (kind, words): SENT until it has acknowledged,
    then ACCEPTED, DONE, REFUSED, UNFINISHED or WITHDRAWN, SILENT if it has not acknowledged in time;  version: counts
    changes of all receipts;  key: what the page calls it that asked for it, so that it is not taken twice.
    """

    number: int
    verb: str
    words: str
    t: float
    answers: dict[int, tuple[str, Any]] = field(default_factory=dict)
    version: int = 0
    key: str = ""

    @property
    def open(self) -> bool:
        """Whether somebody may still answer."""
        return any(kind in (SENT, ACCEPTED) for kind, _ in self.answers.values())

    def done(self) -> bool:
        """Whether all have done it."""
        return bool(self.answers) and all(
            kind == DONE for kind, _ in self.answers.values()
        )


@dataclass(eq=False)
class _Asked:
    """An order to one drone that is still asked of it.

    begun: whether it has acknowledged it;  outdone: the contrary order after which it is not asked again.
    """

    receipt: Receipt
    drone: int
    begun: bool = False
    outdone: str = ""


@dataclass(eq=False)
class _Stop:
    """A stop, or its clearing, that is still sent. targets: the addresses to which;  alone: see emergency_stop."""

    receipt: Receipt
    targets: list[int]
    clear: bool
    alone: bool
    obeyed: dict[int, None] = field(default_factory=dict)

    def has_obeyed(self, i: int) -> bool:
        """Whether drone i has: its agent, and its body where an owner has that."""
        return i in self.obeyed and (
            BODIES + i in self.obeyed or BODIES + i not in self.targets
        )


class Desk:
    """Gives commands; nothing here waits for them: their receipts grow.

    What is ordered later counts. A stop withdraws every open order that could move its drones, an order those older
    ones that are contrary to it and not acknowledged yet, and who is not ready is not asked for such a one again:
    across an outage of the network none of them comes late.
    """

    def __init__(self, place: Place, watch: Watch) -> None:
        self.place = place
        self.watch = watch
        self.receipts: deque[Receipt] = deque()
        self.version = 0
        self._count = 0
        self._tasks: dict[asyncio.Task[None], None] = {}
        self._asked: dict[_Asked, asyncio.Task[None]] = {}
        self._stops: dict[_Stop, None] = {}

    def after(self, version: int) -> list[Receipt]:
        """The receipts that have changed since then, oldest first."""
        return [receipt for receipt in self.receipts if receipt.version > version]

    def ended(self) -> str:
        """Why nobody obeys; empty while somebody may."""
        if self.place.replays:
            return REPLAYED
        return "" if any(map(self.place.is_there, self.place.config.ids)) else ENDED

    def order(
        self,
        verb: str,
        drones: Iterable[int] | None = None,
        seconds: float | None = None,
        words: str = "",
        each: Callable[[int], Mapping[str, Any]] = lambda i: {},
        says: Callable[[Any], Any] = lambda detail: detail,
        first: asyncio.Task[Any] | None = None,
    ) -> Receipt:
        """Command these drones, None: all.

        each: the arguments of each;  says: its answer, as the receipt tells it;  first: what has to be over before a
        drone is asked; a later order, or a stop, counts meanwhile.
        """
        receipt = self._new(
            verb, self.place.config.ids if drones is None else drones, words
        )
        if why := REPLAYED if self.place.replays else "":
            for i in receipt.answers:
                self._answer(receipt, i, REFUSED, why)
            return receipt
        limit = SECONDS.get(verb, REQUEST) if seconds is None else seconds
        if verb in MOTION:
            self._outdo(receipt, BESIDE.get(verb, ()))
        before = {
            asked.drone: task
            for asked, task in self._asked.items()
            if asked.receipt.verb == verb == IN_TURN
        }
        for i in receipt.answers:
            asked = _Asked(receipt, i)
            self._asked[asked] = self._spawn(
                self._ask(asked, limit, each, says, before.get(i, first))
            )
        return receipt

    def stop(
        self, drones: Iterable[int] | None = None, clear: bool = False, key: str = ""
    ) -> Receipt:
        """Emergency stop of these drones, None: of the swarm, in force until it is cleared; or clear it.

        A stop is sent until it is acknowledged, cleared here, or given anew. One of a key that is known is that one: a
        page says it again, and somebody may have cleared it meanwhile.
        """
        if known := [
            receipt for receipt in self.receipts if key and receipt.key == key
        ]:
            return known[0]
        config = self.place.config
        receipt = self._new(
            "clear stop" if clear else "emergency stop",
            config.ids if drones is None else drones,
            "",
        )
        receipt.key = key
        bodies = [BODIES + i for i in config.elsewhere if i in receipt.answers]
        stop = _Stop(
            receipt,
            [*receipt.answers, *bodies],
            clear,
            alone=drones is not None and not clear,
        )
        self._replace(stop)
        if not clear:
            self._withdraw(receipt)
        self._stops[stop] = None
        self._spawn(self._stop(stop))
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
        if len(self.receipts) == KEPT:
            self._forget()
        self.receipts.append(receipt)
        self._changed(receipt)
        return receipt

    def _forget(self) -> None:
        """One receipt, the oldest; one of a stop that is still sent only if there are no others."""
        sent = [stop.receipt for stop in self._stops]
        self.receipts.remove(
            next((one for one in self.receipts if one not in sent), self.receipts[0])
        )

    def _spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks[task] = None
        task.add_done_callback(lambda done: self._tasks.pop(done, None))
        return task

    def _motions(self, newer: Receipt) -> list[_Asked]:
        """What is asked of the drones of a newer order that could move them."""
        return [
            one
            for one in self._asked
            if one.drone in newer.answers and one.receipt.verb in MOTION
        ]

    def _outdo(self, newer: Receipt, beside: Sequence[str]) -> None:
        """Ask for what is contrary to a newer order no more; who has accepted it says by itself what comes of it."""
        for asked in self._motions(newer):
            if asked.receipt.verb in beside:
                continue
            if asked.begun:
                asked.outdone = newer.verb
            else:
                self._drop(asked, newer.verb)

    def _withdraw(self, stop: Receipt) -> None:
        """Ask who is to stop for nothing more that moves him."""
        for asked in self._motions(stop):
            self._drop(asked, "stop")

    def _drop(self, asked: _Asked, by: str) -> None:
        self._asked.pop(asked).cancel()
        self._withdrawn(asked.receipt, asked.drone, by)

    def _replace(self, newer: _Stop) -> None:
        """Send older stops, and clears, to its targets no more; a stop of the swarm stays beside one of some drones."""
        told = dict.fromkeys(newer.targets)
        for older in self._stops:
            if newer.alone and not (older.alone or older.clear):
                continue
            older.targets[:] = [j for j in older.targets if j not in told]
            for i in newer.receipt.answers:
                if older.receipt.answers.get(i, (DONE, ""))[0] in (SENT, SILENT):
                    self._withdrawn(older.receipt, i, newer.receipt.verb)

    def _withdrawn(self, receipt: Receipt, i: int, by: str) -> None:
        """It is no trouble, and not worth a line of the log."""
        receipt.answers[i] = WITHDRAWN, f"by {by}"
        self._changed(receipt)

    def _changed(self, receipt: Receipt) -> None:
        self.version += 1
        receipt.version = self.version

    def _answer(self, receipt: Receipt, i: int, kind: str, words: Any = "") -> None:
        if receipt.answers[i] != (kind, words):
            receipt.answers[i] = kind, words
            self._changed(receipt)
            if kind in (REFUSED, SILENT, UNFINISHED):
                self.watch.add(f"{receipt.verb}: {kind}: {words}", "warning", i)

    async def _ask(
        self,
        asked: _Asked,
        seconds: float,
        each: Callable[[int], Mapping[str, Any]],
        says: Callable[[Any], Any],
        first: asyncio.Task[Any] | None,
    ) -> None:
        clock = self.place.clock
        receipt = asked.receipt
        i = asked.drone
        ends = clock.now() + seconds
        try:
            if first is not None:
                await asyncio.wait([first])
            answer = await self._heard(asked, ends, each(i))
        except TimeoutError:
            self._answer(
                receipt,
                i,
                SILENT,
                f"no answer within {seconds:g} s; is its agent running?",
            )
            return
        except CrazyChoirError as error:
            self._answer(receipt, i, REFUSED, str(error))
            return
        except Exception as error:  # noqa: BLE001 - its receipt tells it
            self._answer(receipt, i, REFUSED, error_text(error))
            return
        finally:
            self._asked.pop(asked, None)
        if asked.outdone and answer.kind == REFUSED:
            self._withdrawn(receipt, i, asked.outdone)
        elif answer.kind == ACCEPTED:
            self._answer(
                receipt, i, UNFINISHED, f"accepted, not done within {seconds:g} s"
            )
        else:
            detail = says(answer.detail) if answer.kind == DONE else answer.detail
            self._answer(receipt, i, answer.kind, "" if detail is None else detail)

    async def _heard(
        self, asked: _Asked, ends: float, arguments: Mapping[str, Any]
    ) -> Answer:
        """Its last answer; it is said if there is none for a while."""
        clock = self.place.clock
        i = asked.drone
        timer = clock.call_at(
            clock.now_ns() + round(ACKNOWLEDGED * 1e9),
            self._unheard,
            asked.receipt,
            i,
            drone=i,
        )
        try:
            return await self._answered(asked, ends, arguments)
        finally:
            timer.cancel()

    async def _answered(
        self, asked: _Asked, ends: float, arguments: Mapping[str, Any]
    ) -> Answer:
        """What it says at last; who is not ready yet is asked again, for at most READY s."""
        clock = self.place.clock
        commander = self.place.commander
        verb = asked.receipt.verb
        asks = min(ends, clock.now() + READY)
        while True:
            left = ends - clock.now()
            answer = await commander.request(
                asked.drone, verb, left, lambda: self._begun(asked), **arguments
            )
            if not _waits(answer) or asked.outdone or clock.now() + RETRY >= asks:
                return answer
            asked.begun = False
            await clock.sleep(RETRY)

    def _begun(self, asked: _Asked) -> None:
        asked.begun = True
        self._answer(asked.receipt, asked.drone, ACCEPTED)

    def _unheard(self, receipt: Receipt, i: int) -> None:
        if receipt.answers[i][0] == SENT:
            why = (
                f"not acknowledged within {ACKNOWLEDGED:g} s"
                if self.place.is_there(i)
                else ABSENT
            )
            self._answer(receipt, i, SENT, f"{why}; resent")

    async def _stop(self, stop: _Stop) -> None:
        """Agents and the bodies at owners; a drone has obeyed when both have. A clear that comes late helps nobody."""
        clock = self.place.clock
        limit = STOP if stop.clear else math.inf
        timer = clock.call_at(clock.now_ns() + round(STOP * 1e9), self._silent, stop)
        order = self.place.commander.emergency_stop(
            stop.targets, stop.clear, limit, stop.alone, stop.obeyed
        )
        sending = asyncio.ensure_future(order)
        try:
            while not sending.done():
                self._tell_obeyed(stop)
                await clock.sleep(LOOK)
            self._tell_obeyed(stop)
        finally:
            sending.cancel()
            timer.cancel()
            del self._stops[stop]

    def _silent(self, stop: _Stop) -> None:
        """Who is waited for no more; a stop goes on being sent."""
        still = "" if stop.clear else ", still sent"
        for i, (kind, _) in stop.receipt.answers.items():
            if kind == SENT:
                body = "; its body has obeyed" if BODIES + i in stop.obeyed else ""
                self._answer(
                    stop.receipt,
                    i,
                    SILENT,
                    f"no acknowledgement within {STOP:g} s{still}{body}",
                )

    def _tell_obeyed(self, stop: _Stop) -> None:
        for i, (kind, _) in stop.receipt.answers.items():
            if kind in (SENT, SILENT) and stop.has_obeyed(i):
                self._answer(
                    stop.receipt, i, DONE, "cleared" if stop.clear else "motors off"
                )


def _waits(answer: Answer) -> bool:
    """Whether it may be asked again soon."""
    return answer.kind == REFUSED and str(answer.detail).startswith(NOT_READY)
