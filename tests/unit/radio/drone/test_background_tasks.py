"""Tasks in the background run until they are done or cancelled."""

import asyncio

from crazychoir.radio.drone.background_tasks import BackgroundTasks


async def test_tasks_in_the_background_run_and_are_cancelled() -> None:
    tasks = BackgroundTasks()
    seen: list[str] = []

    async def note(text: str, seconds: float) -> None:
        try:
            await asyncio.sleep(seconds)
            seen.append(text)
        except asyncio.CancelledError:
            seen.append(f"{text} is cancelled")
            raise

    tasks.start(note("short", 0.0))
    tasks.start(note("long", 60.0))
    await asyncio.sleep(0.01)
    assert seen == ["short"]
    tasks.cancel()
    await asyncio.sleep(0.01)
    assert seen == ["short", "long is cancelled"]
