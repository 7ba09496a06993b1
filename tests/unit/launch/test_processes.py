"""How processes are started, listened to and ended; how their results get here."""

import asyncio
import contextlib
import os
import signal
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.agent.agent import Agent
from crazychoir.agent.mission_runner import MISSION_TIMES
from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import ProcessFailed
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.launch import processes
from crazychoir.launch.processes import (
    OWNER_RESTARTS,
    PROCESS_OUTPUT_LIMITS,
    WORLD_OWNER,
    Owner,
    SwarmLauncher,
    compute_patience,
    read_results,
    run_children,
    write_results,
)
from crazychoir.numerics.kernel_cache import COMPILING_MESSAGE
from crazychoir.runtime.clock import run_virtual


async def child(program):
    process = asyncio.subprocess
    return await asyncio.create_subprocess_exec(
        sys.executable, "-c", program, stdout=process.PIPE, stderr=process.STDOUT
    )


async def handling_child(program, ready):
    """Start a program that exits with 3 on SIGTERM, and wait until its file `ready` says that it does."""
    handles = "import signal, time; signal.signal(15, lambda *_: exit(3))"
    started = await child(f"{handles}; open({str(ready)!r}, 'w').close(); {program}")
    while not ready.exists():  # noqa: ASYNC110 - of another process
        await asyncio.sleep(0.01)
    return started


class Launcher:
    """Starts other programs in place of the agents and of the owners."""

    def __init__(self, folder, start_agent, start_owner=None):
        self.path = folder / "swarm.json"
        self._start_agent = start_agent
        self.start_owner = start_owner

    def result_file(self, group):
        return SwarmLauncher.result_file(self, group)

    async def start_agent(self, group):
        return await self._start_agent(group, self.result_file(group))

    def release_agents(self):
        pass

    @contextlib.asynccontextmanager
    async def pass_on_own_output(self, say):
        yield


async def said_by(program):
    said = []
    await processes._pass_on_output(await child(program), said.append)
    return said


async def test_what_a_child_prints_and_logs_is_passed_on_line_by_line_however_long():
    program = "import sys; print('hello', flush=True); print('x' * 200_000, file=sys.stderr); sys.stdout.write('end')"
    assert await said_by(program) == ["hello", "x" * 200_000, "end"]


async def test_a_line_without_end_is_passed_on_in_parts():
    said = await said_by(f"print('x' * {3 * PROCESS_OUTPUT_LIMITS.line})")
    assert "".join(said) == "x" * 3 * PROCESS_OUTPUT_LIMITS.line
    assert all(len(part) <= 2 * PROCESS_OUTPUT_LIMITS.line for part in said)


def test_results_arrive_as_they_were(tmp_path):
    results = {
        3: {"success": False, "by": {1: 2}, "at": np.arange(3.0)},
        4: {"film": bytes(700_000)},
    }
    write_results(tmp_path / "result", results)
    arrived = read_results(tmp_path / "result")
    assert arrived[3].pop("at").tolist() == results[3].pop("at").tolist()
    assert arrived == results


def test_a_process_that_did_not_get_so_far_has_no_results(tmp_path):
    assert read_results(tmp_path / "nothing") == {}
    write_results(tmp_path / "result", {0: {"success": True}})
    (tmp_path / "result").write_bytes((tmp_path / "result").read_bytes()[:-3])
    assert read_results(tmp_path / "result") == {}


async def test_printed_text_is_no_result_and_drones_without_a_result_are_named(
    tmp_path, monkeypatch
):
    async def start(group, result):
        if group == (0, 1):
            write_results(result, {i: {"success": True} for i in group})
        return await child("print('{}'); raise SystemExit(3)")

    said = []
    found = await run_children(
        Launcher(tmp_path, start), [(0, 1), (2,)], default_swarm(3), said.append
    )
    assert found == {0: {"success": True}, 1: {"success": True}}
    lost = "drone(s) 2: no result: the process ended with code 3"
    assert sorted(said) == [lost, "{}", "{}"]


async def test_a_killed_process_is_told_while_the_others_go_on(tmp_path):
    told = tmp_path / "told"

    async def start(group, result):
        if group == (0,):
            return await child("import os; os.kill(os.getpid(), 9)")
        return await child(
            f"import os, time\nwhile not os.path.exists({str(told)!r}): time.sleep(0.01)"
        )

    def say(line):
        if line == "drone(s) 0: no result: the process was ended by SIGKILL":
            told.touch()

    launcher = Launcher(tmp_path, start)
    async with asyncio.timeout(30.0):
        await run_children(launcher, [(0,), (1,)], default_swarm(2), say)


async def test_what_all_wait_for_is_said_once(tmp_path, monkeypatch):
    async def start(group, result):
        return await child(f"print({COMPILING_MESSAGE!r}); print('other')")

    said = []
    await run_children(
        Launcher(tmp_path, start), [(0,), (1,)], default_swarm(2), said.append
    )
    printed = [line for line in said if "no result" not in line]
    assert sorted(printed) == sorted([COMPILING_MESSAGE, "other", "other"])


async def test_each_cache_that_is_not_kept_is_warned_of_once_in_a_run(
    tmp_path, monkeypatch
):
    """Each process names the folder of the law that it compiled first: the lines differ."""

    async def start(group, result):
        lines = [
            f"cache: compiled laws: no folder, {group}",
            f"cache: tables of contents: /a: full, {group}",
            "cache",
        ]
        return await child("; ".join(f"print({line!r})" for line in lines))

    said = []
    await run_children(
        Launcher(tmp_path, start), [(0,), (1,)], default_swarm(2), said.append
    )
    assert sum(line.startswith("cache: compiled laws: ") for line in said) == 1
    assert sum(line.startswith("cache: tables of contents: ") for line in said) == 1
    assert said.count("cache") == 2


def test_a_result_for_which_there_is_no_room_is_told(tmp_path):
    with pytest.raises(
        ProcessFailed,
        match=r"drones 0: its result is lost: .*/nowhere: .* Set TMPDIR to a folder",
    ):
        write_results(tmp_path / "nowhere" / "result", {0: {"success": True}})


@pytest.mark.parametrize(("number", "name"), [(15, "SIGTERM"), (40, "signal 40")])
async def test_a_signal_that_has_ended_a_process_is_named_or_has_a_number(number, name):
    killed = await child(f"import os; os.kill(os.getpid(), {number})")
    await killed.wait()
    assert processes._describe_end(killed) == f"was ended by {name}"


WAITS = "import signal; signal.signal({0}, lambda *_: exit(3)); print('on', flush=True); signal.pause()"


@pytest.mark.parametrize(
    ("waiting", "flies", "ended"),
    [(True, "time.sleep(60)", [-9, 3]), (False, "time.sleep(0.5); exit(4)", [-9, 4])],
)
async def test_a_process_killed_at_the_start_ends_the_wait_of_the_others(
    tmp_path, monkeypatch, waiting, flies, ended
):
    children, said = [], []

    async def start(group, result):
        if group == (0,):
            children.append(await child("import os; os.kill(os.getpid(), 9)"))
        else:
            children.append(await handling_child(flies, tmp_path / "ready"))
        return children[-1]

    await run_children(
        Launcher(tmp_path, start),
        [(0,), (1,)],
        default_swarm(2),
        said.append,
        lambda: waiting,
    )
    assert [each.returncode for each in children] == ended
    assert (
        "drone(s) 0: ended before the start: the others wait no more" in said
    ) == waiting


def world_that(does, prepares="pass"):
    """In place of the world's owner, a program that prepares, says that it is there, and does."""

    async def start(owner):
        assert owner is WORLD_OWNER
        return await child(
            f"import os, signal, time; {prepares}; print('there', flush=True); {does}"
        )

    return start


async def test_the_world_is_there_before_the_agents_and_ends_after_them(
    tmp_path, monkeypatch
):
    order, there = [], asyncio.Event()

    async def start(group, result):
        order.append("agent begins")
        write_results(result, {0: {"success": True}})
        await there.wait()
        return await child("print('agent ends')")

    def say(line):
        order.append(line)
        if line == "there":
            there.set()

    start_world = world_that(
        "signal.pause()",
        "signal.signal(15, lambda *_: exit(print('world ends')))",
    )
    found = await run_children(
        Launcher(tmp_path, start, start_world),
        [(0,)],
        default_swarm(1),
        say,
        owners=[WORLD_OWNER],
    )
    assert found == {0: {"success": True}}
    assert sorted(order[:2]) == ["agent begins", "there"]
    assert order[2:] == ["agent ends", "world ends"]


@pytest.mark.parametrize(
    ("ends", "end", "orphaned"),
    [
        ("os.kill(os.getpid(), 9)", "was ended by SIGKILL: its drones stop", 0.3),
        ("exit(2)", "ended with code 2: its drones do not fly", 60.0),
    ],
    ids=["killed", "refused: at once"],
)
async def test_without_their_world_agents_end_that_do_not_by_themselves(
    tmp_path, monkeypatch, ends, end, orphaned
):
    children, said = [], []
    go = tmp_path / "go"

    async def start(group, result):
        children.append(await handling_child("time.sleep(60)", tmp_path / "ready"))
        asyncio.get_running_loop().call_soon(go.touch)  # when the run knows it
        return children[-1]

    waits = (
        f"[time.sleep(0.01) for _ in iter(lambda: os.path.exists({str(go)!r}), True)]"
    )
    start_world = world_that(f"{waits}; {ends}")
    monkeypatch.setattr(processes, "ORPHAN_GRACE", orphaned)
    await run_children(
        Launcher(tmp_path, start, start_world),
        [(0,)],
        default_swarm(1),
        said.append,
        owners=[WORLD_OWNER],
    )
    assert children[0].returncode == 3
    assert f"world: its owner {end}" in said


async def test_without_a_dongle_for_good_only_agents_of_its_drones_end(
    tmp_path, monkeypatch
):
    children, said = {}, []

    async def start(group, result):
        seconds = 1.0 if group == (0, 1) else 600.0
        children[group] = await handling_child(
            f"time.sleep({seconds})", tmp_path / f"ready{group[0]}"
        )
        return children[group]

    async def start_owner(owner):
        return await child("exit(1)")

    monkeypatch.setattr(processes, "ORPHAN_GRACE", 0.3)
    dongle = Owner("dongle 1", "", again=True, ids=(1, 2))
    await run_children(
        Launcher(tmp_path, start, start_owner),
        [(0, 1), (2,)],
        default_swarm(3),
        said.append,
        owners=[dongle],
    )
    assert (children[0, 1].returncode, children[2,].returncode) == (0, 3)
    assert (
        said.count("dongle 1: its owner ended with code 1: started again")
        == OWNER_RESTARTS.most_starts
    )


async def test_an_owner_that_cannot_be_started_again_ends_its_agents(
    tmp_path, monkeypatch
):
    children, said = [], []

    async def start(group, result):
        children.append(await handling_child("time.sleep(600)", tmp_path / "ready"))
        return children[-1]

    async def start_owner(owner):
        if said:
            raise ProcessFailed("the fork server", "it has ended")
        return await child("exit(1)")

    monkeypatch.setattr(processes, "ORPHAN_GRACE", 0.3)
    await run_children(
        Launcher(tmp_path, start, start_owner),
        [(0,)],
        default_swarm(1),
        said.append,
        owners=[Owner("mocap", "", again=True)],
    )
    assert children[0].returncode == 3
    assert "mocap: the fork server: it has ended" in said


async def test_agents_that_are_not_started_before_a_signal_never_are(tmp_path):
    children, started = [], []

    async def start(group, result):
        started.append(group)
        if group == (1,):
            os.kill(os.getpid(), signal.SIGINT)
            await asyncio.sleep(600.0)
        ready = WAITS.format(int(signal.SIGINT))
        children.append(await child(ready))
        assert await children[-1].stdout.readline() == b"on\n"
        return children[-1]

    found = await run_children(
        Launcher(tmp_path, start),
        [(0,), (1,), (2,)],
        default_swarm(3),
        lambda line: None,
    )
    assert found == {}
    assert started == [(0,), (1,)]
    assert [each.returncode for each in children] == [3]


async def test_an_agent_that_cannot_be_started_ends_the_run(tmp_path):
    children = []

    async def start(group, result):
        if group == (1,):
            raise ProcessFailed("the fork server", "it has ended")
        children.append(await handling_child("time.sleep(600)", tmp_path / "ready"))
        return children[-1]

    with pytest.raises(ProcessFailed, match="it has ended"):
        await run_children(
            Launcher(tmp_path, start),
            [(0,), (1,)],
            default_swarm(2),
            lambda line: None,
        )
    assert children[0].returncode == 3


async def test_a_signal_is_passed_on_as_what_it_is(tmp_path, monkeypatch):
    children, said = [], []

    async def start(group, result):
        children.append(await child(WAITS.format(int(signal.SIGINT))))
        return children[-1]

    def say(line):
        said.append(line)
        if line == "on":
            os.kill(os.getpid(), signal.SIGINT)

    await run_children(Launcher(tmp_path, start), [(0,)], default_swarm(1), say)
    assert children[0].returncode == 3


async def test_a_child_that_does_not_end_is_killed():
    deaf = await child(
        "import signal; signal.signal(15, signal.SIG_IGN); print('on', flush=True); signal.pause()"
    )
    ready = await child(
        "import signal; signal.signal(15, lambda *_: exit(3)); print('on', flush=True); signal.pause()"
    )
    for process in (deaf, ready):
        assert await process.stdout.readline() == b"on\n"
    await processes._end_all([deaf, ready], 0.3)
    assert (deaf.returncode, ready.returncode) == (-9, 3)


class Lands(CFGuidance):
    """From just below the fence."""

    async def mission(self):
        await self.take_off(2.0)
        began = self.member.clock.now()
        await self.land()
        return {"s": self.member.clock.now() - began}


@pytest.mark.parametrize(
    "flight", [{"landing_speed": 0.05}, {"acceleration_limit": 0.02}, {}], ids=str
)
def test_no_agent_is_killed_while_it_comes_down(flight):
    config = default_swarm(1).replace(
        flight=flight, fence={"min": [-3.0, -3.0, 0.0], "max": [3.0, 3.0, 2.1]}
    )

    async def main(clock):
        agent = Agent(
            clock, config, SimpleNamespace(guidance=lambda i, config: Lands()), (0,)
        )
        return (await agent.run())[0]

    result = run_virtual(main)
    assert result["success"], result
    assert compute_patience(config) > result["s"] + MISSION_TIMES.landing_deadline
