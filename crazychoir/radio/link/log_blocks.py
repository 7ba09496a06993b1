"""The log blocks of a drone, which cflib starts in threads of its own."""

import asyncio
import threading
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig

from crazychoir.errors import LinkFailed
from crazychoir.firmware.requests import LOG_CHANNELS, BlockCommand
from crazychoir.radio.link.loop_caller import LoopCaller, resolve_waiting
from crazychoir.radio.link.pending_requests import PendingRequests
from crazychoir.radio.protocol.crtp import CrtpPort, Packet

RESET_LOGS = Packet(CrtpPort.LOG, LOG_CHANNELS.settings, bytes([BlockCommand.RESET]))
"""Packet that makes the drone drop its log blocks."""

LogCallback = Callable[[dict[str, float], int], None]
"""Callback: called with log variables, and ms since the drone's start at which they were taken."""


class LogBlocks:
    """Lets a drone send log variables over one connection, and drop them.

    uri: address of the drone, for messages
    cf: object of cflib
    calls: brings the values into the event loop
    requests: sends the packet that resets the logs
    """

    def __init__(
        self, uri: str, cf: Crazyflie, calls: LoopCaller, requests: PendingRequests
    ) -> None:
        self._uri = uri
        self._cf = cf
        self._calls = calls
        self._requests = requests

    async def begin(
        self,
        name: str,
        variables: Iterable[str],
        period: float,
        data: LogCallback,
        seconds: float,
    ) -> None:
        """Let the drone send log variables.

        name: name of the log block
        period: s, a multiple of 0.01
        data: called with each set of values
        seconds: s: deadline for the drone to start
        Raises LinkFailed if the drone does not start in time.
        """
        config = LogConfig(name, round(1000.0 * period))
        for variable in variables:
            config.add_variable(variable)
        started = asyncio.get_running_loop().create_future()
        config.data_received_cb.add_callback(
            lambda at, values, block: self._calls.call(data, values, at)
        )
        config.started_cb.add_callback(partial(self._note_start, started))
        config.error_cb.add_callback(
            lambda block, message: self._calls.call(
                _fail_waiting, started, str(message)
            )
        )
        try:
            self._cf.log.add_config(config)
        except (KeyError, AttributeError) as error:
            raise LinkFailed(self._uri, f"log {name}: {error}") from error
        threading.Thread(
            target=config.start, name=f"{self._uri} log", daemon=True
        ).start()
        try:
            async with asyncio.timeout(seconds):
                await started
        except TimeoutError:
            raise LinkFailed(
                self._uri, f"log {name} was not begun within {seconds:g} s"
            ) from None

    def _note_start(
        self, started: "asyncio.Future[None]", block: Any, on: bool
    ) -> None:
        """Note that a log block has started; called from a thread of cflib.

        cflib also calls it for a block that the drone refuses to start; `on` is then false.
        """
        if on:
            self._calls.call(resolve_waiting, started)
        else:
            self._calls.call(_fail_waiting, started, "the drone does not begin it")

    async def reset(self, seconds: float) -> None:
        """Let the drone drop all its log blocks.

        Raises LinkFailed if it does not confirm in time.
        """
        try:
            await self._requests.ask(RESET_LOGS, _is_reset_answer, seconds)
        except TimeoutError:
            raise LinkFailed(
                self._uri, f"its logs were not reset within {seconds:g} s"
            ) from None
        self._cf.log.log_blocks = []


def _is_reset_answer(packet: Packet) -> bool:
    return packet[:2] == RESET_LOGS[:2] and packet.data[:1] == RESET_LOGS.data


def _fail_waiting(waiting: "asyncio.Future[None]", message: str) -> None:
    if not waiting.done():
        waiting.set_exception(LinkFailed("log", message))
