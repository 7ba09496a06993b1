"""Sockets between the processes of a host: killed, stopped and flooding processes, hostile ones, no folder."""

import asyncio
import contextlib
import os
import secrets
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from ports import free_ports
from system.link_children import Child, endpoint
from system.link_process import consensus_here, wall_clock

from crazychoir.bus.port import Bus
from crazychoir.files.user_folders import RUNTIME_VARIABLE

pytestmark = [pytest.mark.system, pytest.mark.real_time]
NOTICED = 2.0
"""s within which a process notices that another one has died."""
PROMPT = 0.5
"""s: oldest message where no process is stopped; this machine may steal some tenths."""
STOPPED = 3.0
"""s for which a process is stopped."""
SEQUENCED = "0005"
"""Kind of the sockets between processes, in /proc/net/unix."""
HOSTILE = """
import os, socket, sys
from crazychoir.bus.codec import encode
from crazychoir.bus.frames import Envelope, Frame, encode_frame
from crazychoir.bus.network.local_address import IDENTITY_MARK, LocalIdentity
from crazychoir.bus.network.local_connection import LAST_PIECE_MARK, PACKET_HEAD
from crazychoir.bus.topics import MESSAGE_TOPICS, MessageClass
import msgspec
path, swarm, name = sys.argv[1:]
os.setuid(65534)
made = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
made.settimeout(5.0)
try:
    made.connect(path)
except PermissionError:
    print("not admitted")
    sys.exit()
stop = Envelope(MESSAGE_TOPICS.emergency_stop.number, 1, (0,), 1, 0, 0.0, "", encode(False))
frame = encode_frame(Frame(name, 7, MessageClass.ESTOP, [stop]))
identity = msgspec.msgpack.encode(LocalIdentity(swarm, name, 7))
try:
    made.send(bytes([IDENTITY_MARK]) + identity)
    for _ in range(10):
        made.send(PACKET_HEAD.pack(LAST_PIECE_MARK, 0, 0) + frame)
except OSError:
    pass
try:
    print("read", len(made.recv(1000)))
except OSError:
    print("read 0")
"""
"""A program of another user that takes the name of a process of the swarm."""


class Host:
    """The processes of one swarm on this host: process k, named by a letter, has drone k."""

    def __init__(self, folder: Path, stack: contextlib.AsyncExitStack) -> None:
        self.folder = folder
        self.swarm = f"test-{secrets.token_hex(4)}"
        self._stack = stack
        self._ports = free_ports(range(6))

    async def start(self, k: int, name: str) -> Child:
        """Start a process that connects to all others."""
        ends = [endpoint(self._ports + j) for j in range(6)]
        return await Child.start(
            {
                "process": name,
                "swarm": self.swarm,
                "drones": [k],
                "lease": 20.0,
                "listen": [ends[k]],
                "connect": [end for end in ends if end != ends[k]],
            },
            self._stack,
        )

    async def start_all(self, count: int) -> list[Child]:
        """Start processes, and wait until each is connected with each."""
        names = [f"{chr(ord('a') + k)}-1" for k in range(count)]
        children = await asyncio.gather(
            *(self.start(k, name) for k, name in enumerate(names))
        )
        for child, own in zip(children, names, strict=True):
            await reports(child, "connected", *(name for name in names if name != own))
        return children


async def reports(child: Child, key: str, *names: str) -> dict[str, Any]:
    """Wait until an entry of the status of a process has these names and no more; return the status."""
    async with asyncio.timeout(10):
        while True:
            status = await child.ask("status")
            if set(status[key]) == set(names):
                return status
            await asyncio.sleep(0.02)


def count_sockets(child: Child) -> int:
    """Return how many sockets between processes a process has open."""
    lines = Path("/proc/net/unix").read_text().splitlines()[1:]
    inodes = {line.split()[6] for line in lines if line.split()[4] == SEQUENCED}
    folder = Path(f"/proc/{child.process.pid}/fd")
    targets = [os.readlink(fd) for fd in folder.iterdir()]
    return sum(
        target.startswith("socket:") and target[8:-1] in inodes for target in targets
    )


async def average(children: list[Child], rounds: int, channel: str) -> None:
    """Let the first drones average in rounds; the answers must be those of one process."""
    size = len(children)
    found = await asyncio.gather(
        *(
            child.ask("consensus", size=size, rounds=rounds, channel=channel)
            for child in children
        )
    )
    assert {i: x for one in found for i, x in one.items()} == await answer_alone(
        size, rounds
    )


async def answer_alone(size: int, rounds: int) -> dict[str, list[float]]:
    """Return the averages if all drones are in one process."""
    async with wall_clock() as clock:
        alone = Bus(clock)
        for i in range(size):
            alone.port(i)
        fields = type("Link", (), {"bus": alone})
        return await consensus_here(fields, size, rounds)


@pytest.fixture
async def host(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Host]:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name) / "run"
        folder.mkdir(mode=0o700)
        monkeypatch.setenv(RUNTIME_VARIABLE, str(folder))
        async with contextlib.AsyncExitStack() as stack:
            yield Host(folder, stack)


async def test_a_process_killed_amid_rounds_leaves_no_socket_and_the_others_go_on(
    host: Host,
) -> None:
    *others, victim = await host.start_all(4)
    path = (await victim.ask("status"))["path"]
    for child in [*others, victim]:
        await child.ask("begin", work="consensus", size=4, rounds=10**6)
    await asyncio.sleep(0.5)
    assert [count_sockets(child) for child in others] == [4] * 3
    victim.process.kill()
    names = ["a-1", "b-1", "c-1"]
    async with asyncio.timeout(NOTICED):
        for child, own in zip(others, names, strict=True):
            left = [name for name in names if name != own]
            await reports(child, "heard", *left)
            await reports(child, "connected", *left)
    assert [count_sockets(child) for child in others] == [3] * 3
    for child in others:
        await child.ask("cancel", work="consensus")
    await average(others, 200, "after")
    assert os.access(path, os.F_OK)
    os.utime(path, (0, 0))  # a new socket is left alone for some seconds
    again = await host.start(3, "d-2")
    assert not os.access(path, os.F_OK)
    await reports(again, "connected", *names)
    await average([*others, again], 200, "again")
    for child in [*others, again]:
        status = await child.ask("status")
        assert (status["counters"]["failed"], status["counters"]["full"]) == (0, 0)
        assert await child.end() == ""
    assert list(host.folder.glob("*.sock")) == []


async def test_a_stopped_process_delays_no_other_pair_and_goes_on_with_the_rounds(
    host: Host,
) -> None:
    children = await host.start_all(4)
    *others, victim = children
    rounds = 800
    for k, child in enumerate(others):
        to = [j for j in range(4) if j != k]
        await child.ask("begin", work="stream", to=to, period=0.005, size=2000)
    for child in children:
        await child.ask("begin", work="consensus", size=4, rounds=rounds)
    await asyncio.sleep(0.1)
    os.kill(victim.process.pid, signal.SIGSTOP)
    await asyncio.sleep(0.3)
    for child in others:
        await child.ask("arrivals")
    await asyncio.sleep(STOPPED)
    during = [await child.ask("arrivals") for child in others]
    os.kill(victim.process.pid, signal.SIGCONT)
    found = [await child.ask("finish", work="consensus") for child in children]
    assert {i: x for one in found for i, x in one.items()} == await answer_alone(
        4, rounds
    )
    for child in others:
        await child.ask("cancel", work="stream")
    for k, arrived in enumerate(during):
        assert set(arrived["worst_age"]) == {str(j) for j in range(3) if j != k}
        assert max(arrived["worst_age"].values()) < PROMPT
        assert_complete(arrived["messages"])
    late = await victim.ask("arrivals")
    assert max(late["worst_age"].values()) > STOPPED / 2, "they waited in the socket"
    for child in children:
        status = await child.ask("status")
        assert status["counters"]["full"] == 0, "its sockets and queues have room"


def assert_complete(messages: list[tuple[str, int, int]]) -> None:
    """No number is missing, from the first to the last one of each source."""
    for source in {source for _, source, _ in messages}:
        numbers = [number for _, j, number in messages if j == source]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        assert len(numbers) > 100


async def test_only_the_sender_that_fills_a_socket_loses_frames(host: Host) -> None:
    children = await host.start_all(4)
    greedy, modest, free, victim = children
    os.kill(victim.process.pid, signal.SIGSTOP)
    await greedy.ask("begin", work="stream", to=[2], period=0.005)
    await modest.ask("begin", work="stream", to=[2, 3], period=0.005)
    await greedy.ask("send", to=[3], count=100, size=100_000, first=10_000)
    await asyncio.sleep(1.0)
    full = [
        (await child.ask("status"))["counters"]["full"]
        for child in (greedy, modest, free)
    ]
    assert 0 < full[0] < 100
    assert full[1:] == [0, 0]
    os.kill(victim.process.pid, signal.SIGCONT)
    for child in (greedy, modest):
        await child.ask("cancel", work="stream")
    await asyncio.sleep(0.2)
    there = await free.ask("arrivals")
    assert {source for _, source, _ in there["messages"]} == {0, 1}
    assert_complete(there["messages"])
    assert max(there["worst_age"].values()) < PROMPT
    late = (await victim.ask("arrivals"))["messages"]
    assert_complete([message for message in late if message[1] == 1])
    greedy_numbers = [number for _, source, number in late if source == 0]
    assert greedy_numbers == list(range(10_000, 10_100 - full[0]))


async def test_an_emergency_stop_and_control_overtake_waiting_bulk(host: Host) -> None:
    sender, victim = await host.start_all(2)
    os.kill(victim.process.pid, signal.SIGSTOP)
    await sender.ask("send", to=[1], count=30, size=100_000, topic="result")
    await sender.ask("send", to=[1], count=20, size=100)
    await sender.ask("send", to=[1], count=3, size=100, topic="sought")
    await sender.ask("send", to=[1], count=1, size=100, topic="estop")
    os.kill(victim.process.pid, signal.SIGCONT)
    await asyncio.sleep(0.5)
    arrived = (await victim.ask("arrivals"))["messages"]
    topics = [topic for topic, _, _ in arrived]
    of_socket = topics.index("estop")
    assert set(topics[:of_socket]) == {"result"}, "these were in the socket already"
    assert topics[of_socket + 1 : of_socket + 4] == ["sought"] * 3
    rounds = [number for topic, _, number in arrived if topic == "answer"]
    assert rounds == list(range(20))
    assert topics[of_socket + 4 : of_socket + 24] == ["answer"] * 20
    waiting = topics[of_socket + 24 :]
    assert set(waiting) == {"result"}
    assert of_socket < 10 < len(waiting), "a megabyte waited behind"


@pytest.mark.parametrize("can_be_made", [True, False])
async def test_without_the_folder_of_the_sockets_all_processes_talk(
    host: Host, can_be_made: bool
) -> None:
    early = await host.start_all(2)
    shutil.rmtree(host.folder)
    if not can_be_made:
        host.folder.write_text("in the way")
    await average(early, 100, "two")
    assert (await early[0].ask("status"))["connected"] == ["b-1"]
    late = await host.start(2, "c-1")
    status = await reports(late, "connected", *(("a-1", "b-1") if can_be_made else ()))
    assert bool(status["path"]) == can_be_made
    first = await host.start(3, "0-1")  # it would connect to the others
    await reports(first, "connected", *(("c-1",) if can_be_made else ()))
    await reports(first, "heard_by", "a-1", "b-1", "c-1")
    await average([*early, late, first], 100, "four")


@pytest.mark.skipif(os.getuid() != 0, reason="only root can act as another user")
async def test_a_process_of_another_user_reads_nothing_and_steers_nothing(
    host: Host,
) -> None:
    children = await host.start_all(2)
    status = await children[0].ask("status")
    assert stat.S_IMODE(host.folder.stat().st_mode) == 0o700

    async def attack() -> str:
        ended = await asyncio.to_thread(
            subprocess.run,
            [sys.executable, "-c", HOSTILE, status["path"], host.swarm, "b-1"],
            capture_output=True,
            text=True,
            timeout=20,
        )
        assert ended.returncode == 0, ended.stderr
        return ended.stdout.strip()

    host.folder.parent.chmod(0o755)
    assert await attack() == "not admitted"
    assert (await children[0].ask("status"))["counters"]["strangers"] == status[
        "counters"
    ]["strangers"]
    host.folder.chmod(0o777)
    os.chmod(status["path"], 0o777)  # noqa: S103 - what may come in all the same
    assert await attack() == "read 0"
    after = await children[0].ask("status")
    assert after["counters"]["strangers"] == status["counters"]["strangers"] + 1
    assert after["connected"] == ["b-1"]
    assert (await children[0].ask("arrivals"))["messages"] == []
    await average(children, 100, "main")


async def test_a_flood_delays_the_ticks_of_its_victim_no_more_than_another_flood(
    host: Host,
) -> None:
    flooder, victim, other = await host.start_all(3)
    seconds = 1.0
    added = []
    for _ in range(3):
        late = {}
        for name in ("b-1", "c-1"):
            await flooder.ask("begin", work="flood", process=name, seconds=seconds)
            late[name] = (await victim.ask("ticks", seconds=seconds))["p99_ms"]
            rate = (await flooder.ask("finish", work="flood"))["rate"]
        added.append(late["b-1"] - late["c-1"])
        if added[-1] < 2.0:
            break
    assert rate > 20_000
    assert min(added) < 2.0, added
    for child in (victim, other):
        assert (await child.ask("status"))["counters"]["flooded"] > 1000
