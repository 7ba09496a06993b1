"""Tests that are coroutines in virtual time."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from crazychoir.runtime.clock import Clock, run_virtual


def virtual(test: Callable[[Clock], Coroutine[Any, Any, None]]) -> Callable[[], None]:
    """The test `async def test(clock)` as a function for pytest, without fixtures; no alarm may fail unheard."""

    async def main(clock: Clock) -> None:
        unheard: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(
            lambda loop, context: unheard.append(context)
        )
        await test(clock)
        assert unheard == []

    def run() -> None:
        run_virtual(main)

    run.__name__, run.__doc__, run.__module__ = (
        test.__name__,
        test.__doc__,
        test.__module__,
    )
    return run
