"""Requests that are sent until they are answered."""

import asyncio
import math

import pytest

from crazychoir.radio.link.pending_requests import PendingRequests
from crazychoir.radio.protocol.crtp import Packet

REQUEST = Packet(2, 1, b"\x01")
ANSWER = Packet(2, 1, b"\x01\x00")
OTHER = Packet(2, 1, b"\x02\x00")


def is_answer(packet: Packet) -> bool:
    return packet == ANSWER


async def test_a_request_is_repeated_until_its_answer_arrives() -> None:
    sent, heard = [], []

    def send(packet: Packet) -> None:
        sent.append(packet)
        requests.take(ANSWER if len(sent) == 3 else OTHER)

    requests = PendingRequests(send, heard.append)
    assert await requests.ask(REQUEST, is_answer, 5.0, 0.01) == ANSWER
    assert sent == [REQUEST] * 3
    assert heard == [OTHER, OTHER, ANSWER], "all that arrives is passed on"


async def test_a_request_that_must_not_be_repeated_is_sent_once() -> None:
    sent = []
    requests = PendingRequests(sent.append, lambda packet: None)
    with pytest.raises(TimeoutError):
        await requests.ask(REQUEST, is_answer, 0.05, math.inf)
    assert sent == [REQUEST]


async def test_requests_of_a_closed_connection_are_cancelled() -> None:
    requests = PendingRequests(lambda packet: None, lambda packet: None)
    asking = asyncio.ensure_future(requests.ask(REQUEST, is_answer, 60.0))
    await asyncio.sleep(0)
    requests.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asking
