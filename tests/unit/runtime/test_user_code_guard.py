"""User code that does not return: interrupted in virtual time, in hooks, and between two awaits of a mission."""

import asyncio
import contextvars
import dataclasses
import re
import threading
import time
from types import SimpleNamespace

import pytest

from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import ConfigError, Hung
from crazychoir.guidance import user_hook as hooked
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.flight import fly_fast
from crazychoir.runtime import user_code_guard as hanging
from crazychoir.runtime import user_module
from crazychoir.runtime.user_code_guard import (
    GuardedCoroutine,
    HangWatch,
    limit_duration,
    share_watch,
)

BRISK = {
    "takeoff_height": 0.3,
    "speed_limit": 2.0,
    "acceleration_limit": 4.0,
    "landing_speed": 0.6,
}


@pytest.fixture
def hasty(monkeypatch):
    """What may take minutes may take a fifth of a second here."""
    monkeypatch.setattr(
        hanging,
        "USER_CODE_TIMES",
        dataclasses.replace(
            hanging.USER_CODE_TIMES,
            check_interval=0.02,
            step_limit=0.2,
            mission_limit=0.2,
        ),
    )


def forever():
    while True:
        pass


def test_code_that_is_limited_ends_in_time_or_is_interrupted():
    with limit_duration(5.0, "a hook"):
        done = 1 + 1
    assert done == 2
    began = time.perf_counter()
    with pytest.raises(Hung), limit_duration(0.1, "a hook"):
        forever()
    assert time.perf_counter() - began < 3.0


def count_threads(monkeypatch):
    """Return a list that gets the name of each thread that is started."""
    started = []
    start = threading.Thread.start

    def note(thread):
        started.append(thread.name)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", note)
    return started


def test_one_thread_watches_all_hooks_of_a_shared_watch(monkeypatch):
    started = count_threads(monkeypatch)
    with share_watch():
        for _ in range(5):
            with limit_duration(5.0, "a hook"):
                pass
    assert started == ["hang watch"]
    with limit_duration(5.0, "a hook"):
        pass
    assert started == ["hang watch"] * 2


def test_each_hook_of_a_shared_watch_has_its_own_limit(hasty):
    with share_watch():
        for limit in (0.1, 0.3):
            began = time.perf_counter()
            with pytest.raises(Hung), limit_duration(limit, "a hook"):
                forever()
            assert limit <= time.perf_counter() - began < 3.0
        with limit_duration(5.0, "a hook"):
            pass


def test_a_hook_inside_another_one_does_not_end_the_watch_of_the_outer_one(hasty):
    def hang():
        with limit_duration(0.1, "the outer hook"):
            with limit_duration(5.0, "the inner hook"):
                pass
            forever()

    with share_watch(), pytest.raises(Hung):
        hang()


def test_a_hook_in_another_thread_is_interrupted_there(hasty):
    def work():
        with pytest.raises(Hung), limit_duration(0.1, "a hook"):
            forever()
        ended.append(True)

    ended = []
    with share_watch():
        context = contextvars.copy_context()
        thread = threading.Thread(target=context.run, args=(work,))
        thread.start()
        thread.join(10.0)
    assert ended == [True]


def test_a_long_computation_is_named_with_its_place_before_it_is_given_up(
    hasty, monkeypatch, caplog
):
    monkeypatch.setattr(
        hanging,
        "USER_CODE_TIMES",
        dataclasses.replace(hanging.USER_CODE_TIMES, first_report=0.1, step_limit=0.6),
    )
    config = default_swarm(3).replace(flight=BRISK)
    fly_fast(config, SimpleNamespace(guidance=lambda i, config: Law(i, forever)))
    said = [text for text in caplog.messages if "has computed" in text]
    assert 1 <= len(said) <= 3, "and ever more rarely"
    place = rf"{__file__}:\d+ forever; it is given up after 0.6 s"
    assert all(
        re.fullmatch(rf"drone 1 guidance has computed for \d s, in {place}", text)
        for text in said
    ), said


def test_a_guarded_coroutine_is_the_same_as_a_bare_one():
    async def inner(fails):
        await asyncio.sleep(0)
        try:
            await asyncio.wait_for(asyncio.get_running_loop().create_future(), 0.001)
        except TimeoutError:
            heard.append("timeout")
        if fails:
            raise ValueError("no")
        return 42

    async def outer():
        with HangWatch() as watch:
            assert (
                await GuardedCoroutine(
                    inner(False), watch, "drone 0 guidance", lambda: True
                )
                == 42
            )
            with pytest.raises(ValueError, match="no"):
                await GuardedCoroutine(
                    inner(True), watch, "drone 0 guidance", lambda: False
                )

            async def waits():
                try:
                    await asyncio.get_running_loop().create_future()
                except asyncio.CancelledError:
                    heard.append("cancelled")
                    raise

            async def runs():
                await GuardedCoroutine(waits(), watch, "drone 0 guidance", lambda: True)

            task = asyncio.create_task(runs())
            await asyncio.sleep(0.01)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

    heard = []
    asyncio.run(outer())
    assert heard == ["timeout", "timeout", "cancelled"]


class Law(CFDistributedFeedback):
    duration = 3.0

    def __init__(self, i, spoil):
        self.i, self.spoil, self.steps = i, spoil, 0

    def step(self, me, heard):
        self.steps += 1
        if self.i == 1 and self.steps == 50:
            self.spoil()


class Mission(CFGuidance):
    def __init__(self, i, spoil):
        self.i, self.spoil = i, spoil

    async def mission(self):
        await self.take_off()
        await self.sleep(1.0)
        if self.i == 1:
            self.spoil()
        await self.sleep(1.0)
        await self.land()


def fails():
    raise ValueError("no idea")


@pytest.mark.parametrize("kind", [Law, Mission])
@pytest.mark.parametrize(
    ("spoil", "why"), [(forever, "Hung"), (fails, "ValueError: no idea")]
)
def test_in_virtual_time_the_drone_of_code_that_hangs_or_raises_lands_and_the_others_fly_on(
    hasty, kind, spoil, why
):
    config = default_swarm(3).replace(flight=BRISK)
    result = fly_fast(
        config, SimpleNamespace(guidance=lambda i, config: kind(i, spoil))
    )
    assert [result["results"][i]["success"] for i in range(3)] == [True, False, True], (
        result["results"]
    )
    assert "guidance failed: " + why in result["reasons"][1]
    assert "test_user_code_guard.py:" in result["reasons"][1]
    assert f" {spoil.__name__})" in result["reasons"][1]
    assert "crash" not in str(result["reasons"])


@pytest.mark.parametrize("hook", ["guidance", "report", "import"])
def test_a_hook_or_a_file_that_does_not_end_is_said_with_its_line(
    tmp_path, monkeypatch, hook
):
    monkeypatch.setattr(
        hooked,
        "USER_CODE_TIMES",
        dataclasses.replace(hooked.USER_CODE_TIMES, hook_limit=0.2),
    )
    monkeypatch.setattr(user_module, "USER_CODE_TIMES", hooked.USER_CODE_TIMES)
    path = tmp_path / "mine.py"
    loop = "    while True:\n        pass\n"
    bodies = {
        name: loop if hook == name else "    return {}\n"
        for name in ("guidance", "report")
    }
    top = "while True:\n    pass\n" if hook == "import" else ""
    path.write_text(
        f"def guidance(i, config):\n{bodies['guidance']}def report(config, results):\n{bodies['report']}{top}"
    )
    config = default_swarm(1)
    if hook == "report":
        found = load_mission(str(path)).report(config, {})
        assert found["success"] is False
        said = found["reasons"][0]
    else:
        with pytest.raises(ConfigError) as caught:
            load_mission(str(path)).guidance(0, config)
        said = str(caught.value)
    assert "no end within 0.2 s" in said
    assert any(f"mine.py:{line}" in said for line in range(2, 8))
