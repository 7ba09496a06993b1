from types import SimpleNamespace

from virtual_time import virtual

from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.dashboard.event_log import EventLog
from crazychoir.dashboard.receipts import RECEIPT_KINDS, ReceiptBook
from crazychoir.dashboard.stops import STOP_TIMEOUT, StopSender

BODY = PORT_ADDRESSES.body_offset + 0


class Stopped:
    """A place that notes each stop; the body of drone 0 is in another process."""

    def __init__(self, clock):
        self.clock = clock
        self.commander = self
        self.config = SimpleNamespace(topology=SimpleNamespace(elsewhere=[0]))
        self.sent = []

    async def emergency_stop(self, targets, clear, limit, alone, obeyed):
        self.sent.append((targets, obeyed, clear, alone))
        await self.clock.sleep(min(limit, 1000.0))


def sender(clock):
    place = Stopped(clock)
    book = ReceiptBook(clock, EventLog(clock))
    return place, book, StopSender(place, book)


@virtual
async def test_a_drone_has_stopped_when_its_agent_and_its_body_have_obeyed(clock):
    place, book, stops = sender(clock)
    receipt = book.add("emergency stop", [0, 1], "")
    stops.send(receipt, clear=False, alone=True)
    await clock.sleep(0.1)
    ((targets, obeyed, clear, alone),) = place.sent
    assert (targets, clear, alone) == ([0, 1, BODY], False, True)
    obeyed |= {0: None, 1: None}
    await clock.sleep(0.1)
    done = (ANSWER_TEXTS.done, "motors off")
    assert receipt.answers == {0: (RECEIPT_KINDS.sent, ""), 1: done}
    obeyed[BODY] = None
    await clock.sleep(0.1)
    assert receipt.answers == {0: done, 1: done}
    stops.close()


@virtual
async def test_a_silent_agent_is_named_and_so_is_a_body_that_has_obeyed(clock):
    place, book, stops = sender(clock)
    receipt = book.add("emergency stop", [0], "")
    stops.send(receipt, clear=False, alone=False)
    await clock.sleep(0.1)
    place.sent[0][1][BODY] = None
    await clock.sleep(STOP_TIMEOUT)
    assert receipt.answers[0] == (
        RECEIPT_KINDS.silent,
        f"no acknowledgement within {STOP_TIMEOUT:g} s, still sent; its body has obeyed",
    )
    assert len(stops.pending) == 1
    stops.close()


@virtual
async def test_a_clear_is_sent_for_a_limited_time_only(clock):
    _, book, stops = sender(clock)
    stops.send(book.add("clear stop", [1], ""), clear=True, alone=False)
    await clock.sleep(STOP_TIMEOUT - 0.1)
    assert len(stops.pending) == 1
    await clock.sleep(0.3)
    assert stops.pending == {}


@virtual
async def test_a_newer_stop_takes_over_the_targets_of_an_older_one(clock):
    place, book, stops = sender(clock)
    older, newer = (book.add("emergency stop", drones, "") for drones in ([1, 2], [2]))
    stops.send(older, clear=False, alone=True)
    stops.send(newer, clear=False, alone=True)
    await clock.sleep(0.1)
    assert [targets for targets, *_ in place.sent] == [[1], [2]]
    assert older.answers[2] == (RECEIPT_KINDS.withdrawn, "by emergency stop")
    stops.close()
