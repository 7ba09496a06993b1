"""Log blocks that a drone begins, refuses, or does not answer about."""

import asyncio
from types import SimpleNamespace

import pytest

from crazychoir.errors import LinkFailed
from crazychoir.radio.link.log_blocks import RESET_LOGS, LogBlocks
from crazychoir.radio.link.loop_caller import LoopCaller
from crazychoir.radio.link.pending_requests import PendingRequests
from crazychoir.radio.protocol.crtp import CrtpPort, Packet


class Drone:
    """A drone behind cflib that keeps the blocks, and answers a reset if it is to."""

    def __init__(self, answers: bool = True) -> None:
        self.blocks = []
        self.sent = []
        self._answers = answers
        self.requests = PendingRequests(self._send, lambda packet: None)
        self.log = SimpleNamespace(add_config=self._add, log_blocks=["old"])

    def _add(self, block) -> None:
        block.cf = SimpleNamespace(link=None)
        self.blocks.append(block)

    def _send(self, packet) -> None:
        self.sent.append(packet)
        if self._answers:
            answer = Packet(CrtpPort.LOG, 1, packet.data + b"\0\0")
            self.requests.take(Packet(CrtpPort.LOG, 2, packet.data))
            self.requests.take(answer)

    def make_blocks(self) -> LogBlocks:
        calls = LoopCaller(asyncio.get_running_loop())
        return LogBlocks("udp://127.0.0.1:9", self, calls, self.requests)


@pytest.mark.parametrize("on", [True, False])
async def test_a_log_that_the_drone_does_not_begin_fails_at_once(on) -> None:
    drone = Drone()
    logging = asyncio.ensure_future(
        drone.make_blocks().begin(
            "own", ["pm.vbat"], 0.1, lambda values, at: None, 30.0
        )
    )
    await asyncio.sleep(0)
    drone.blocks[0].started_cb.call(
        drone.blocks[0] if on else drone.log, on
    )  # as cflib does
    if on:
        await logging
    else:
        with pytest.raises(LinkFailed, match="does not begin"):
            await logging


async def test_a_log_without_an_answer_fails_at_its_deadline() -> None:
    begins = Drone().make_blocks().begin("own", ["x.y"], 0.1, lambda v, at: None, 0.02)
    with pytest.raises(LinkFailed, match=r"log own was not begun within 0\.02 s"):
        await begins


async def test_a_variable_that_the_drone_does_not_have_is_named() -> None:
    drone = Drone()

    def refuse(block) -> None:
        raise KeyError("Variable no.such not in TOC")

    drone.log.add_config = refuse
    with pytest.raises(LinkFailed, match=r"log own: .*no\.such not in TOC"):
        await drone.make_blocks().begin("own", ["no.such"], 0.1, print, 1.0)


async def test_values_arrive_with_the_time_of_the_drone() -> None:
    drone, told = Drone(), []
    begins = asyncio.ensure_future(
        drone.make_blocks().begin(
            "own", ["pm.vbat"], 0.1, lambda values, at: told.append((values, at)), 1.0
        )
    )
    await asyncio.sleep(0)
    (block,) = drone.blocks
    block.started_cb.call(block, True)
    await begins
    block.data_received_cb.call(1500, {"pm.vbat": 4.0}, block)
    await asyncio.sleep(0.01)
    assert told == [({"pm.vbat": 4.0}, 1500)]


async def test_a_confirmed_reset_forgets_the_blocks_and_a_silent_drone_fails() -> None:
    drone = Drone()
    await drone.make_blocks().reset(1.0)
    assert (drone.sent, drone.log.log_blocks) == ([RESET_LOGS], [])
    silent = Drone(answers=False)
    with pytest.raises(LinkFailed, match=r"its logs were not reset within 0\.02 s"):
        await silent.make_blocks().reset(0.02)
    assert silent.log.log_blocks == ["old"]
