"""Flight by hand: a stream of velocities of a stick, arrow keys or a program, sent to one drone."""

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass

from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.dashboard.command_place import CommandPlace
from crazychoir.dashboard.receipts import RECEIPT_KINDS, Receipt, ReceiptBook
from crazychoir.types import Point

STICK_VERB = "velocity"
"""The command."""


@dataclass(frozen=True, slots=True)
class StickTimes:
    """How long the velocities of a stick count."""

    velocity_duration: float = 0.5
    """s for which a drone flies a velocity, if the page sends no newer one."""
    release_duration: float = 0.1
    """s of the zero velocity at the release of the stick; the drone then rests."""
    patience: float = 5.0
    """s for which the zero velocity is repeated until the drone answers."""


STICK_TIMES = StickTimes()


def is_release(v: Point, yaw_rate: float) -> bool:
    """Return whether a velocity (3,) and a yaw rate are the zeros that end a flight by hand."""
    return not (any(v) or yaw_rate)


@dataclass
class _StickFlight:
    """The flight of one drone by hand, from the first velocity to the release."""

    receipt: Receipt
    """Its receipt."""
    sending: asyncio.Task[None] | None = None
    """Sends the newest velocity."""
    is_released: bool = False
    """Whether the newest velocity is the zero that ends the flight."""


class StickSender:
    """Sends velocities of a stick; each replaces the one before, which is not sent again.

    A drone that hears of no new velocity for STICK_TIMES.velocity_duration s comes to rest. Fence and
    collision filter act as on all velocities.

    After another command, such as a hold, a stick that is held or a program that goes on sending does not take
    the drone back: it must be released, or rest for STICK_TIMES.velocity_duration s, first.

    place: place on the network from which they are sent
    book: receipts, one for each flight by hand
    """

    def __init__(self, place: CommandPlace, book: ReceiptBook) -> None:
        self._place = place
        self._book = book
        self._flights: dict[int, _StickFlight] = {}
        # The flights that another command ended, and when a velocity for them last came, in s.
        self._ended: dict[int, tuple[Receipt, float]] = {}

    def steer(self, drone: int, v: Point, yaw_rate: float) -> Receipt:
        """Send a velocity (3,) m/s, world, and a yaw rate in rad/s; zeros end the flight by hand.

        A stream may repeat its zeros: only the first ones are sent.
        """
        ended = self._keep_ended(drone, is_release(v, yaw_rate))
        if ended is not None:
            return ended
        flight = self._flights.get(drone)
        if flight is None:
            receipt = self._book.add(STICK_VERB, (drone,), "by hand")
            flight = self._flights[drone] = _StickFlight(receipt)
        is_released = is_release(v, yaw_rate)
        if is_released and flight.is_released:
            return flight.receipt
        flight.is_released = is_released
        if flight.sending is not None:
            flight.sending.cancel()
        work = self._send(drone, flight, list(map(float, v)), yaw_rate, is_released)
        flight.sending = asyncio.get_running_loop().create_task(work)
        return flight.receipt

    def _keep_ended(self, drone: int, is_released: bool) -> Receipt | None:
        """Return the receipt of the flight that another command ended, if velocities still come for it."""
        if drone not in self._ended:
            return None
        receipt, last = self._ended.pop(drone)
        now = self._place.clock.now()
        if now - last >= STICK_TIMES.velocity_duration:
            return None
        if not is_released:
            self._ended[drone] = (receipt, now)
        return receipt

    def flies(self, drone: int) -> bool:
        """Return whether a drone flies by hand."""
        return drone in self._flights

    def end(self, drones: Iterable[int], by: str) -> None:
        """Send no more to these drones, because of another command."""
        for i in drones:
            flight = self._flights.pop(i, None)
            if flight is None or flight.sending is None:
                continue
            flight.sending.cancel()
            if not flight.is_released:
                self._ended[i] = (flight.receipt, self._place.clock.now())
            if flight.receipt.open:
                self._book.withdraw(flight.receipt, i, by)

    def close(self) -> None:
        """Cancel all waiting."""
        for flight in self._flights.values():
            if flight.sending is not None:
                flight.sending.cancel()

    async def _send(
        self,
        drone: int,
        flight: _StickFlight,
        v: list[float],
        yaw_rate: float,
        is_released: bool,
    ) -> None:
        """Send one velocity until it is flown or replaced, and note the end of the flight.

        A refusal does not end it while the stick is held: the next velocities have the same receipt.
        """
        receipt = flight.receipt
        times = STICK_TIMES

        def note_acceptance() -> None:
            if receipt.open:  # a drone accepts a command before it refuses it
                self._book.answer(receipt, drone, ANSWER_TEXTS.accepted)

        duration = times.release_duration if is_released else times.velocity_duration
        try:
            answer = await self._place.commander.request(
                drone,
                STICK_VERB,
                times.patience if is_released else 2.0 * duration,
                note_acceptance,
                v=v,
                yaw_rate=yaw_rate,
                duration=duration,
            )
        except TimeoutError as error:
            self._flights.pop(drone, None)
            self._book.answer(receipt, drone, RECEIPT_KINDS.silent, str(error))
            return
        detail = "" if answer.detail is None else answer.detail
        self._book.answer(receipt, drone, answer.kind, detail)
        if answer.kind == ANSWER_TEXTS.refused and not is_released:
            await self._place.clock.sleep(times.velocity_duration)
        self._flights.pop(drone, None)
