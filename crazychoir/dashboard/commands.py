"""Commands from pages, and their receipts: which drones acknowledged, finished or are silent."""

import asyncio
import math
from collections import deque
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from crazychoir.bus.commands import (
    ANSWER_TEXTS,
    Answer,
    Commander,
)
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.dashboard.event_log import EventLog
from crazychoir.errors import CrazyChoirError, error_text
from crazychoir.runtime.clock import Clock


@dataclass(frozen=True, slots=True)
class ReceiptKinds:
    """Kinds of answers in a receipt that this program adds to the answers of the drones."""

    sent: str = "sent"
    """Kind of answer: not acknowledged yet."""
    silent: str = "silent"
    """Kind of answer: not acknowledged in time."""
    unfinished: str = "unfinished"
    """Kind of answer: accepted, not done in time; the drone may still do it."""
    withdrawn: str = "withdrawn"
    """Kind of answer: withdrawn by a later order."""


RECEIPT_KINDS = ReceiptKinds()


@dataclass(frozen=True, slots=True)
class ReceiptTexts:
    """Words for why a drone, or the whole swarm, does not obey."""

    absent: str = "no agent of it is there"
    """Words of a receipt if no agent answers for the drone."""
    replayed: str = "REPLAY: no drone obeys"
    """Words of a refusal if the messages come from a recording."""
    ended: str = "ENDED: no drone is there"
    """Notice of the page if no drone is there any more."""


RECEIPT_TEXTS = ReceiptTexts()


@dataclass(frozen=True, slots=True)
class OrderLimits:
    """Times that the drones get for a command, and the number of receipts."""

    acknowledge_timeout: float = 2.0
    """Seconds within which a drone should acknowledge a command.

    The command is resent before and after that time.
    """
    request_timeout: float = 5.0
    """Seconds to wait for a command that is not a motion."""
    stop_timeout: float = 10.0
    """Seconds after which a drone that has not acknowledged a stop is called silent."""
    check_period: float = 0.05
    """Seconds between two checks."""
    ready_timeout: float = 15.0
    """Seconds for which a drone that is not ready yet is asked again."""
    retry_period: float = 0.3
    """Seconds between two such requests."""
    most_receipts: int = 50
    """Number of receipts that are kept."""


ORDER_LIMITS = OrderLimits()


MOTION_TIMEOUTS = {
    "arm": 5.0,
    "take-off": 30.0,
    "start": 5.0,
    "hold": 5.0,
    "go": 5.0,
    "land": 60.0,
    "home": 120.0,
    "go-to": 120.0,
}
"""Seconds to wait until each command is done; all others get ORDER_LIMITS.request_timeout seconds."""
MOTION_ORDERS = (*MOTION_TIMEOUTS, "fly")
"""Orders that move a drone or let it move; a stop of the drone withdraws them."""
COMPATIBLE_ORDERS = {
    "arm": MOTION_ORDERS,
    "take-off": ("arm", "start", "go"),
    "start": ("arm", "take-off", "hold", "go"),
    "go": ("arm", "take-off", "start"),
    "go-to": ("take-off", "hold"),
    "fly": ("take-off", "hold"),
}
"""For each order, the older orders that remain valid beside it.

It withdraws all other orders that are not acknowledged yet.
"""
SEQUENTIAL_ORDER = "impair"
"""A drone gets the next order of this kind only after it has answered the previous one.

Some of these orders add up, others do not, so their sequence matters.
"""


class CommandPlace(Protocol):
    """The place on the network from which commands are given."""

    clock: Clock
    config: SwarmConfig
    commander: Commander

    def is_there(self, i: int) -> bool:
        """Return whether an agent answers for drone i."""
        ...

    @property
    def replays(self) -> bool:
        """Whether the messages come from a recording."""
        ...


@dataclass
class Receipt:
    """A command and the answers of the drones."""

    number: int
    """Number of the command, from 1."""
    verb: str
    """Name of the command."""
    words: str
    """Its arguments, for display."""
    t: float
    """s, when it was given."""
    answers: dict[int, tuple[str, Any]] = field(default_factory=dict)
    """By drone, (kind, words).

    The kind is "sent" until the drone acknowledges, then "accepted", "done", "refused", "unfinished" or "withdrawn".
    It is "silent" if the drone has not acknowledged in time.
    """
    version: int = 0
    """Number of the change after which this receipt was last changed, over all receipts."""
    key: str = ""
    """Key that the page gave the command, so that a repeated command counts only once."""

    @property
    def open(self) -> bool:
        """Whether a drone may still answer."""
        return any(
            kind in (RECEIPT_KINDS.sent, ANSWER_TEXTS.accepted)
            for kind, _ in self.answers.values()
        )

    def done(self) -> bool:
        """Return whether all drones have done it."""
        return bool(self.answers) and all(
            kind == ANSWER_TEXTS.done for kind, _ in self.answers.values()
        )


@dataclass(eq=False)
class _PendingOrder:
    """An order to one drone that is still being sent or carried out."""

    receipt: Receipt
    """Receipt of the order."""
    drone: int
    """Id of the drone."""
    begun: bool = False
    """Whether the drone has acknowledged it."""
    outdone: str = ""
    """Name of a later, contrary order after which it is not sent again; empty if there is none."""


@dataclass(eq=False)
class _PendingStop:
    """A stop, or its clearing, that is still being sent."""

    receipt: Receipt
    """Receipt of the stop."""
    targets: list[int]
    """Addresses to which it is sent."""
    clear: bool
    """Whether it clears a stop."""
    alone: bool
    """Whether it stops only some drones, see emergency_stop."""
    obeyed: dict[int, None] = field(default_factory=dict)
    """Addresses that have obeyed."""

    def has_obeyed(self, i: int) -> bool:
        """Return whether drone i has obeyed: its agent, and its body if another process owns it."""
        return i in self.obeyed and (
            PORT_ADDRESSES.body_offset + i in self.obeyed
            or PORT_ADDRESSES.body_offset + i not in self.targets
        )


class CommandDesk:
    """Gives commands without waiting for them; their receipts are updated as answers come.

    Later orders take precedence. A stop withdraws every open order that could move its drones. An
    order withdraws older contrary orders that are not acknowledged yet. A drone that is not ready
    is not asked again for an order that a later one contradicts. After an outage of the network
    no such order therefore arrives late.
    """

    def __init__(self, place: CommandPlace, watch: EventLog) -> None:
        self.place = place
        self.watch = watch
        self.receipts: deque[Receipt] = deque()
        self.version = 0
        self._count = 0
        self._tasks: dict[asyncio.Task[None], None] = {}
        self._asked: dict[_PendingOrder, asyncio.Task[None]] = {}
        self._stops: dict[_PendingStop, None] = {}

    def after(self, version: int) -> list[Receipt]:
        """Return the receipts that have changed since `version`, oldest first."""
        return [receipt for receipt in self.receipts if receipt.version > version]

    def ended(self) -> str:
        """Return the reason why no drone can obey; empty if a drone may."""
        if self.place.replays:
            return RECEIPT_TEXTS.replayed
        return (
            ""
            if any(map(self.place.is_there, self.place.config.ids))
            else RECEIPT_TEXTS.ended
        )

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
        """Send a command to drones.

        verb: name of the command.
        drones: ids, None for all.
        seconds: s, time until it should be done; None for the default of the command.
        words: its arguments, for display.
        each: returns the arguments for a drone.
        says: turns the detail of an answer into text for the receipt.
        first: task that must end before a drone is asked; a later order or a stop takes effect
            meanwhile.
        """
        receipt = self._new(
            verb, self.place.config.ids if drones is None else drones, words
        )
        if why := RECEIPT_TEXTS.replayed if self.place.replays else "":
            for i in receipt.answers:
                self._answer(receipt, i, ANSWER_TEXTS.refused, why)
            return receipt
        limit = (
            MOTION_TIMEOUTS.get(verb, ORDER_LIMITS.request_timeout)
            if seconds is None
            else seconds
        )
        if verb in MOTION_ORDERS:
            self._outdo(receipt, COMPATIBLE_ORDERS.get(verb, ()))
        before = {
            asked.drone: task
            for asked, task in self._asked.items()
            if asked.receipt.verb == verb == SEQUENTIAL_ORDER
        }
        for i in receipt.answers:
            asked = _PendingOrder(receipt, i)
            self._asked[asked] = self._spawn(
                self._ask(asked, limit, each, says, before.get(i, first))
            )
        return receipt

    def stop(
        self, drones: Iterable[int] | None = None, clear: bool = False, key: str = ""
    ) -> Receipt:
        """Stop drones at once until the stop is cleared, or clear a stop.

        The stop is sent until it is acknowledged, cleared here, or given again. If the key is
        known the existing receipt is returned: the page repeats its message, and the stop may
        have been cleared meanwhile.

        drones: ids, None for the whole swarm.
        clear: whether to clear a stop.
        key: key of the page's message.
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
        bodies = [
            PORT_ADDRESSES.body_offset + i
            for i in config.topology.elsewhere
            if i in receipt.answers
        ]
        stop = _PendingStop(
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
        """Wait until no drone may answer any more, and return the receipt."""
        while receipt.open:
            await self.place.clock.sleep(ORDER_LIMITS.check_period)
        return receipt

    def close(self) -> None:
        """Cancel all waiting."""
        for task in self._tasks:
            task.cancel()

    def _new(self, verb: str, drones: Iterable[int], words: str) -> Receipt:
        self._count += 1
        receipt = Receipt(self._count, verb, words, round(self.place.clock.now(), 2))
        receipt.answers = {i: (RECEIPT_KINDS.sent, "") for i in drones}
        if len(self.receipts) == ORDER_LIMITS.most_receipts:
            self._forget()
        self.receipts.append(receipt)
        self._changed(receipt)
        return receipt

    def _forget(self) -> None:
        """Remove the oldest receipt; receipts of stops that are still sent are removed last."""
        sent = [stop.receipt for stop in self._stops]
        self.receipts.remove(
            next((one for one in self.receipts if one not in sent), self.receipts[0])
        )

    def _spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks[task] = None
        task.add_done_callback(lambda done: self._tasks.pop(done, None))
        return task

    def _motions(self, newer: Receipt) -> list[_PendingOrder]:
        """Return the open orders that could move a drone of a newer order."""
        return [
            one
            for one in self._asked
            if one.drone in newer.answers and one.receipt.verb in MOTION_ORDERS
        ]

    def _outdo(self, newer: Receipt, beside: Sequence[str]) -> None:
        """Withdraw the open orders that a newer order contradicts.

        An order that was already acknowledged stays open, and its drone reports the outcome.
        """
        for asked in self._motions(newer):
            if asked.receipt.verb in beside:
                continue
            if asked.begun:
                asked.outdone = newer.verb
            else:
                self._drop(asked, newer.verb)

    def _withdraw(self, stop: Receipt) -> None:
        """Withdraw all open orders that could move a drone that is to stop."""
        for asked in self._motions(stop):
            self._drop(asked, "stop")

    def _drop(self, asked: _PendingOrder, by: str) -> None:
        self._asked.pop(asked).cancel()
        self._withdrawn(asked.receipt, asked.drone, by)

    def _replace(self, newer: _PendingStop) -> None:
        """Do not send older stops and clears to the targets of a newer stop any more.

        A stop of the whole swarm remains in force beside a stop of some drones.
        """
        told = dict.fromkeys(newer.targets)
        for older in self._stops:
            if newer.alone and not (older.alone or older.clear):
                continue
            older.targets[:] = [j for j in older.targets if j not in told]
            for i in newer.receipt.answers:
                if older.receipt.answers.get(i, (ANSWER_TEXTS.done, ""))[0] in (
                    RECEIPT_KINDS.sent,
                    RECEIPT_KINDS.silent,
                ):
                    self._withdrawn(older.receipt, i, newer.receipt.verb)

    def _withdrawn(self, receipt: Receipt, i: int, by: str) -> None:
        """Mark an order as withdrawn; this is no trouble and not worth a line of the log."""
        receipt.answers[i] = RECEIPT_KINDS.withdrawn, f"by {by}"
        self._changed(receipt)

    def _changed(self, receipt: Receipt) -> None:
        self.version += 1
        receipt.version = self.version

    def _answer(self, receipt: Receipt, i: int, kind: str, words: Any = "") -> None:
        if receipt.answers[i] != (kind, words):
            receipt.answers[i] = kind, words
            self._changed(receipt)
            if kind in (
                ANSWER_TEXTS.refused,
                RECEIPT_KINDS.silent,
                RECEIPT_KINDS.unfinished,
            ):
                self.watch.add(f"{receipt.verb}: {kind}: {words}", "warning", i)

    async def _ask(
        self,
        asked: _PendingOrder,
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
                RECEIPT_KINDS.silent,
                f"no answer within {seconds:g} s; is its agent running?",
            )
            return
        except CrazyChoirError as error:
            self._answer(receipt, i, ANSWER_TEXTS.refused, str(error))
            return
        except Exception as error:  # noqa: BLE001 - its receipt tells it
            self._answer(receipt, i, ANSWER_TEXTS.refused, error_text(error))
            return
        finally:
            self._asked.pop(asked, None)
        if asked.outdone and answer.kind == ANSWER_TEXTS.refused:
            self._withdrawn(receipt, i, asked.outdone)
        elif answer.kind == ANSWER_TEXTS.accepted:
            self._answer(
                receipt,
                i,
                RECEIPT_KINDS.unfinished,
                f"accepted, not done within {seconds:g} s",
            )
        else:
            detail = (
                says(answer.detail)
                if answer.kind == ANSWER_TEXTS.done
                else answer.detail
            )
            self._answer(receipt, i, answer.kind, "" if detail is None else detail)

    async def _heard(
        self, asked: _PendingOrder, ends: float, arguments: Mapping[str, Any]
    ) -> Answer:
        """Return the last answer of a drone; report if it does not acknowledge in time."""
        clock = self.place.clock
        i = asked.drone
        timer = clock.call_at(
            clock.now_ns() + round(ORDER_LIMITS.acknowledge_timeout * 1e9),
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
        self, asked: _PendingOrder, ends: float, arguments: Mapping[str, Any]
    ) -> Answer:
        """Return the last answer of a drone; ask again for ORDER_LIMITS.ready_timeout s if it is not ready yet."""
        clock = self.place.clock
        commander = self.place.commander
        verb = asked.receipt.verb
        asks = min(ends, clock.now() + ORDER_LIMITS.ready_timeout)
        while True:
            left = ends - clock.now()
            answer = await commander.request(
                asked.drone, verb, left, lambda: self._begun(asked), **arguments
            )
            if (
                not _may_be_repeated(answer)
                or asked.outdone
                or clock.now() + ORDER_LIMITS.retry_period >= asks
            ):
                return answer
            asked.begun = False
            await clock.sleep(ORDER_LIMITS.retry_period)

    def _begun(self, asked: _PendingOrder) -> None:
        asked.begun = True
        self._answer(asked.receipt, asked.drone, ANSWER_TEXTS.accepted)

    def _unheard(self, receipt: Receipt, i: int) -> None:
        if receipt.answers[i][0] == RECEIPT_KINDS.sent:
            why = (
                f"not acknowledged within {ORDER_LIMITS.acknowledge_timeout:g} s"
                if self.place.is_there(i)
                else RECEIPT_TEXTS.absent
            )
            self._answer(receipt, i, RECEIPT_KINDS.sent, f"{why}; resent")

    async def _stop(self, stop: _PendingStop) -> None:
        """Send a stop to the agents, and to the bodies that other processes own.

        A drone has obeyed when both have. A clear is only sent for ORDER_LIMITS.stop_timeout s, because a late one is
        of no use.
        """
        clock = self.place.clock
        limit = ORDER_LIMITS.stop_timeout if stop.clear else math.inf
        timer = clock.call_at(
            clock.now_ns() + round(ORDER_LIMITS.stop_timeout * 1e9), self._silent, stop
        )
        order = self.place.commander.emergency_stop(
            stop.targets, stop.clear, limit, stop.alone, stop.obeyed
        )
        sending = asyncio.ensure_future(order)
        try:
            while not sending.done():
                self._tell_obeyed(stop)
                await clock.sleep(ORDER_LIMITS.check_period)
            self._tell_obeyed(stop)
        finally:
            sending.cancel()
            timer.cancel()
            del self._stops[stop]

    def _silent(self, stop: _PendingStop) -> None:
        """Mark the drones that have not acknowledged as silent; a stop is still sent to them."""
        still = "" if stop.clear else ", still sent"
        for i, (kind, _) in stop.receipt.answers.items():
            if kind == RECEIPT_KINDS.sent:
                body = (
                    "; its body has obeyed"
                    if PORT_ADDRESSES.body_offset + i in stop.obeyed
                    else ""
                )
                self._answer(
                    stop.receipt,
                    i,
                    RECEIPT_KINDS.silent,
                    f"no acknowledgement within {ORDER_LIMITS.stop_timeout:g} s{still}{body}",
                )

    def _tell_obeyed(self, stop: _PendingStop) -> None:
        for i, (kind, _) in stop.receipt.answers.items():
            if kind in (RECEIPT_KINDS.sent, RECEIPT_KINDS.silent) and stop.has_obeyed(
                i
            ):
                self._answer(
                    stop.receipt,
                    i,
                    ANSWER_TEXTS.done,
                    "cleared" if stop.clear else "motors off",
                )


def _may_be_repeated(answer: Answer) -> bool:
    """Return whether the command may be repeated soon."""
    return answer.kind == ANSWER_TEXTS.refused and str(answer.detail).startswith(
        ANSWER_TEXTS.not_ready
    )
