"""Sockets between the processes of a host: two ends in one event loop, with real sockets."""

import asyncio
import os
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
import uvloop

from crazychoir.bus.frames import FRAME_FORMAT
from crazychoir.bus.network import local_address, local_connection, local_sockets
from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.local_address import LocalAddress, LocalIdentity
from crazychoir.bus.network.local_connection import (
    CONNECTION_SIZES,
    LAST_PIECE_MARK,
    PACKET_HEAD,
    PIECE_MARK,
    LeavingFrame,
)
from crazychoir.bus.network.local_sockets import MOST_STRANGERS, LocalSockets
from crazychoir.bus.topics import MessageClass
from crazychoir.files.user_folders import RUNTIME_VARIABLE

VERSION = bytes([FRAME_FORMAT.version])


class End:
    """One process: its sockets, and the frames that it has received."""

    def __init__(self, name: str, swarm: str = "swarm", incarnation: int = 1) -> None:
        self.frames: list[tuple[str, bytes]] = []
        self.waits: list[float] = []
        """Seconds from the sending of each frame to its reading."""
        self.known = True
        self.counters = LinkCounters()
        self.sockets = LocalSockets(
            LocalIdentity(swarm, name, incarnation),
            lambda identity: self.known,
            self.counters,
            time.monotonic_ns,
        )
        self.sockets.open(self._receive)

    def send(
        self, process: str, frame: bytes, klass: MessageClass = MessageClass.ROUNDS
    ) -> bool:
        """Send a frame to another end."""
        connection = self.sockets.connections[process]
        return connection.send_at_once(frame) or self.sockets.send(
            process, klass, frame
        )

    def _receive(self, process: str, frame: bytes, sent_ns: int) -> None:
        self.frames.append((process, frame))
        self.waits.append((time.monotonic_ns() - sent_ns) / 1e9)


@pytest.fixture
def ends(tmp_path, monkeypatch) -> Iterator[Callable[..., End]]:
    """Makes ends, and closes them."""
    folder = tmp_path / "run"
    folder.mkdir(mode=0o700)
    monkeypatch.setenv(RUNTIME_VARIABLE, str(folder))
    made: list[End] = []

    def make(name: str, swarm: str = "swarm") -> End:
        made.append(End(name, swarm))
        return made[-1]

    yield make
    for end in made:
        end.sockets.close()
    assert list(folder.iterdir()) == []


async def until(condition: Callable[[], object]) -> None:
    """Wait for it."""
    async with asyncio.timeout(5.0):
        while not condition():  # noqa: ASYNC110 - sockets change it, and no task
            await asyncio.sleep(0.001)


async def connect(one: End, two: End) -> None:
    """Let each reach the other, as after their HELLOs."""
    for end, other in ((one, two), (two, one)):
        end.sockets.reach(other.sockets.identity.process, other.sockets.address)
    names = [end.sockets.identity.process for end in (one, two)]
    await until(
        lambda: (
            names[1] in one.sockets.connections and names[0] in two.sockets.connections
        )
    )


async def test_a_frame_does_not_overtake_another_on_its_way_out(ends):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    connection = a.sockets.connections["b"]
    assert connection.send_at_once(VERSION + b"1")
    connection.leaving = LeavingFrame(VERSION + b"2", time.monotonic_ns())
    assert not connection.send_at_once(VERSION + b"3")
    connection.leaving = None


async def test_frames_go_both_ways_in_order(ends):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    frames = [VERSION + bytes([n]) for n in range(100)]
    for frame in frames:
        a.send("b", frame)
        b.send("a", frame)
    await until(lambda: len(a.frames) == len(b.frames) == 100)
    assert b.frames == [("a", frame) for frame in frames]
    assert a.frames == [("b", frame) for frame in frames]


@pytest.mark.parametrize("extra", [-1, 0, 1, 500_000])
async def test_large_frames_go_in_pieces(ends, extra):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    frame = VERSION + os.urandom(CONNECTION_SIZES.piece_size - 1 + extra)
    a.send("b", frame)
    a.send("b", VERSION)
    await until(lambda: len(b.frames) == 2)
    assert b.frames == [("a", frame), ("a", VERSION)]


@pytest.mark.parametrize("size", [400_000, 650_000])
@pytest.mark.parametrize("buffer_size", [30_000, 212_992])
async def test_large_frames_arrive_where_the_system_grants_small_buffers(
    ends, monkeypatch, size, buffer_size
):
    """A grant of 425984 bytes, twice the larger one, is usual."""
    small = replace(CONNECTION_SIZES, buffer_size=buffer_size)
    monkeypatch.setattr(local_connection, "CONNECTION_SIZES", small)
    a, b = ends("a"), ends("b")
    await connect(a, b)
    for count in (1, 2):
        frame = VERSION + os.urandom(size)
        assert a.send("b", frame)
        await until(lambda count=count: len(b.frames) == count)
        assert b.frames[-1] == ("a", frame)


@pytest.mark.parametrize("sends_too_late", [False, True])
@pytest.mark.parametrize("run", [asyncio.run, uvloop.run])
def test_what_a_process_has_sent_before_its_end_is_read(ends, sends_too_late, run):
    async def main() -> None:
        a, b = ends("a"), ends("b")
        await connect(a, b)
        b.send("a", VERSION + b"unread")
        for n in range(10):
            a.send("b", VERSION + bytes([n]))
        connection = b.sockets.connections["a"]
        a.sockets.close()
        if sends_too_late:
            b.send("a", VERSION + b"too late")
        await until(lambda: len(b.frames) == 10)
        await until(lambda: connection.socket.fileno() < 0)
        assert "a" not in b.sockets.connections
        assert b.counters.broken == 1
        b.sockets.close()

    run(main())


async def test_a_pass_reads_one_frame_of_each_connection(ends):
    b = ends("b0")
    others = [ends(f"a{n}") for n in range(10)]
    for other in others:
        await connect(other, b)
    for other in others:
        for _ in range(20):
            other.send("b0", VERSION)
    before = len(b.frames)
    await asyncio.sleep(0.0)
    await asyncio.sleep(0.0)
    assert 0 < len(b.frames) - before <= 2 * 10
    await until(lambda: len(b.frames) == 200)


async def test_a_frame_to_a_process_that_has_ended_is_not_sent(ends):
    """The connection is read on until its end, and then closed with all others."""
    a, b = ends("a"), ends("b")
    await connect(a, b)
    connection = a.sockets.connections["b"]
    b.sockets.connections["a"].socket.close()
    assert not a.send("b", VERSION)
    assert a.counters.broken == 1
    assert "b" not in a.sockets.connections
    a.sockets.close()
    assert connection.socket.fileno() < 0


async def test_a_process_of_the_same_name_takes_the_place(ends):
    a, old = ends("a"), ends("b")
    await connect(a, old)
    new = End("b", incarnation=2)
    try:
        a.sockets.reach("b", new.sockets.address)
        await until(lambda: "a" in new.sockets.connections)
        a.send("b", VERSION)
        await until(lambda: new.frames)
        assert old.frames == []
    finally:
        new.sockets.close()


async def test_only_sockets_of_the_own_folder_are_reached(ends, tmp_path):
    a, b = ends("a"), ends("b")
    link = tmp_path / "elsewhere.sock"
    link.symlink_to(b.sockets.address.path)
    for path in (str(link), "\0abstract", ""):
        a.sockets.reach("b", LocalAddress(b.sockets.address.machine, path))
        assert "b" not in a.sockets.connections


async def test_silent_connections_do_not_keep_others_out(ends):
    a, b = ends("a"), ends("b")
    silent = [
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for _ in range(MOST_STRANGERS)
    ]
    try:
        for one in silent:
            one.connect(b.sockets.address.path)
        await until(lambda: len(b.sockets._strangers) == len(silent))
        await connect(a, b)
        assert len(b.sockets._strangers) == len(silent) - 1
        assert silent[0].recv(10) == b"", "the oldest one was closed"
    finally:
        for one in silent:
            one.close()


async def test_a_process_that_does_not_read_loses_frames_and_hurts_no_other(ends):
    a, b, c = ends("a"), ends("b"), ends("c")
    await connect(a, b)
    await connect(a, c)
    frame = VERSION + bytes(50_000)
    taken = sum(a.send("b", frame) for _ in range(200))
    assert a.send("c", frame)
    assert 0 < taken < 100
    assert a.counters.full == 200 - taken
    await until(lambda: c.frames)
    await until(lambda: len(b.frames) == taken)
    a.send("b", VERSION)
    await until(lambda: b.frames[-1] == ("a", VERSION))


async def test_urgent_frames_go_before_waiting_ones_of_other_classes(ends):
    """Each class keeps its order, and a frame that is being sent is not cut in two."""
    a, b = ends("a"), ends("b")
    await connect(a, b)
    for n in range(20):
        assert a.send("b", VERSION + bytes([n]) * 200_000, MessageClass.BULK)
        if a.sockets.connections["b"].leaving is not None:
            break
    for n in range(3):
        assert a.send("b", VERSION + b"bulk%d" % n, MessageClass.BULK)
        assert a.send("b", VERSION + b"round%d" % n, MessageClass.ROUNDS)
        assert a.send("b", VERSION + b"control%d" % n, MessageClass.CONTROL)
        assert a.send("b", VERSION + b"estop%d" % n, MessageClass.ESTOP)
    await until(lambda: ("a", VERSION + b"bulk2") in b.frames)
    assert [frame[1:].decode() for _, frame in b.frames if len(frame) < 20] == [
        name + str(n)
        for name in ("estop", "control", "round", "bulk")
        for n in range(3)
    ]
    assert all(len(set(frame[1:])) == 1 for _, frame in b.frames if len(frame) > 20)


@pytest.mark.parametrize(
    ("klass", "lost"),
    [(MessageClass.ROUNDS, "newest"), (MessageClass.CONTROL, "oldest")],
)
async def test_without_room_control_frames_replace_older_ones(ends, klass, lost):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    frames = [VERSION + bytes([n]) * 100_000 for n in range(100)]
    for frame in frames:
        a.send("b", frame, klass)
    count = len(frames) - a.counters.full
    assert 0 < count < 100
    await until(lambda: len(b.frames) == count)
    arrived = [frame for _, frame in b.frames]
    if lost == "newest":
        assert arrived == frames[:count]
    else:
        assert arrived[-10:] == frames[-10:]


async def test_a_class_without_room_leaves_the_others_theirs(ends):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    while a.send("b", VERSION + bytes(100_000), MessageClass.BULK):
        pass
    assert a.send("b", VERSION + b"stop", MessageClass.ESTOP)
    await until(lambda: ("a", VERSION + b"stop") in b.frames)


async def test_a_large_frame_is_dropped_whole_or_arrives_whole(ends):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    big = VERSION + os.urandom(600_000)
    taken = sum(a.send("b", big) for _ in range(10))
    assert 0 < taken < 10
    await until(lambda: len(b.frames) == taken)
    assert a.send("b", big)
    await until(lambda: len(b.frames) == taken + 1)
    assert all(frame == big for _, frame in b.frames)


async def test_an_end_that_closes_is_noticed_and_may_come_again(ends):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    b.sockets.close()
    await until(lambda: "b" not in a.sockets.connections)
    again = ends("b")
    await connect(a, again)
    a.send("b", VERSION)
    await until(lambda: again.frames)


async def test_sockets_of_processes_that_were_killed_are_removed(ends):
    a = ends("a")
    folder = Path(a.sockets.address.path).parent
    stale = folder / "stale.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as killed:
        killed.bind(str(stale))
    os.utime(stale, (time.time() - 60.0,) * 2)
    b = ends("b")
    assert sorted(folder.iterdir()) == sorted(
        Path(end.sockets.address.path) for end in (a, b)
    )
    await connect(a, b)


async def test_processes_that_start_together_do_not_connect_to_find_stale_sockets(ends):
    a = ends("a")
    ends("b")
    await asyncio.sleep(0)
    with pytest.raises(BlockingIOError):
        a.sockets._listening.accept()


@pytest.mark.parametrize(("age", "stays"), [(0.0, True), (60.0, False)])
async def test_sockets_of_processes_killed_before_they_listened_are_removed(
    ends, age, stays
):
    """A new one may belong to a process that is going to listen."""
    a = ends("a")
    begun = Path(a.sockets.address.path).with_name("begun.new")
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as killed:
        killed.bind(str(begun))
    os.utime(begun, (time.time() - age,) * 2)
    ends("b")
    assert begun.exists() == stays
    begun.unlink(missing_ok=True)


async def test_without_free_file_descriptors_the_network_is_used(ends, caplog):
    a, b = ends("a"), ends("b")
    await asyncio.sleep(0.02)  # b has looked if a is there
    most = resource.getrlimit(resource.RLIMIT_NOFILE)
    lowest_free = os.dup(0)
    os.close(lowest_free)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as asking:
        asking.setblocking(False)
        asking.connect(b.sockets.address.path)
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free, most[1]))
        try:
            a.sockets.reach("b", b.sockets.address)
            await until(lambda: not os.access(b.sockets.address.path, os.F_OK))
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, most)
    assert "no further local sockets" in caplog.text
    assert "b" not in a.sockets.connections


async def test_the_lesser_name_connects(ends):
    a, b = ends("a"), ends("b")
    b.sockets.reach("a", a.sockets.address)
    await asyncio.sleep(0.02)
    assert "b" not in a.sockets.connections
    assert "a" not in b.sockets.connections


async def test_another_network_namespace_is_another_host(ends):
    a, b = ends("a"), ends("b")
    elsewhere = LocalAddress("another machine", b.sockets.address.path)
    a.sockets.reach("b", elsewhere)
    assert "b" not in a.sockets.connections


@pytest.mark.parametrize("swarm", ["swarm", "another"])
async def test_strangers_are_refused(ends, swarm):
    a, b = ends("a", swarm), ends("b")
    b.known = swarm != "swarm"
    a.sockets.reach("b", b.sockets.address)
    await until(lambda: b.counters.strangers == 1)
    await until(lambda: "b" not in a.sockets.connections)
    assert "a" not in b.sockets.connections


@pytest.mark.parametrize("packet", [VERSION + b"frame", b"\xf2\xff", b"\xf2"])
async def test_a_connection_without_an_identity_is_closed(ends, packet):
    b = ends("b")
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as raw:
        raw.connect(b.sockets.address.path)
        raw.send(packet)
        await until(lambda: b.counters.malformed == 1)
        raw.setblocking(False)
        assert raw.recv(10) == b""
    assert b.frames == []


@pytest.mark.parametrize("size", [1, 300_000])
async def test_a_frame_ages_while_its_reader_is_busy(ends, size):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    a.send("b", VERSION * size)
    time.sleep(0.1)  # noqa: ASYNC251 - the event loop of the reader is to hang
    await until(lambda: b.frames)
    assert 0.1 <= b.waits[0] < 1.0


@pytest.mark.parametrize(
    "packet",
    [
        b"\x00",
        b"\xf0",
        b"\xf1123",
        PACKET_HEAD.pack(0xF2, 0, 0) + b"another mark",
        PACKET_HEAD.pack(LAST_PIECE_MARK, 0, 0),
        PACKET_HEAD.pack(PIECE_MARK, 0, 0),
    ],
)
async def test_packets_that_are_no_frames_are_counted(ends, packet):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    a.sockets.connections["b"].socket.send(packet)
    a.send("b", VERSION)
    await until(lambda: b.frames)
    assert b.frames == [("a", VERSION)]
    assert b.counters.malformed == 1


async def test_a_whole_frame_amid_pieces_ends_their_frame(ends):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    for mark, start, content in (
        (PIECE_MARK, 0, b"abc"),
        (LAST_PIECE_MARK, 0, VERSION),
        (LAST_PIECE_MARK, 3, b"def"),
        (LAST_PIECE_MARK, 0, VERSION),
    ):
        packet = PACKET_HEAD.pack(mark, start, 0) + content
        a.sockets.connections["b"].socket.send(packet)
    await until(lambda: len(b.frames) == 2)
    assert b.frames == [("a", VERSION)] * 2


@pytest.mark.skipif(os.getuid() != 0, reason="only root can act as another user")
async def test_a_process_of_another_user_is_a_stranger(ends, monkeypatch):
    b = ends("b")
    path = Path(b.sockets.address.path)
    for place in (path, path.parent, *path.parent.parents):
        if place != Path("/"):
            place.chmod(0o777)
    try:
        program = (
            "import os, socket, sys; os.setuid(65534); "
            "s = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET); "
            "s.connect(sys.argv[1]); print(len(s.recv(10)))"
        )
        ended = await asyncio.to_thread(
            subprocess.run,
            [sys.executable, "-c", program, str(path)],
            capture_output=True,
            text=True,
            timeout=10,
        )
    finally:
        path.parent.chmod(0o700)
    await until(lambda: b.counters.strangers == 1)
    assert ended.stdout.strip() == "0", ended.stderr


async def test_a_reader_may_end_the_connection(ends):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    b.sockets._receive = lambda process, frame, sent_ns: b.sockets.forget(process)
    for _ in range(3):
        a.send("b", VERSION)
    await until(lambda: "b" not in a.sockets.connections)
    assert b.counters.broken == 0


async def test_a_second_connection_of_a_process_takes_the_place_of_the_first(ends):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    path = Path(b.sockets.address.path)
    with local_address.connect_to(path, a.sockets.identity):
        await until(lambda: "b" not in a.sockets.connections)
        assert "a" in b.sockets.connections


async def test_pieces_that_do_not_follow_each_other_are_no_frame(ends):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    raw = a.sockets.connections["b"].socket
    head = local_connection.PACKET_HEAD
    go_on, last = local_connection.PIECE_MARK, local_connection.LAST_PIECE_MARK
    raw.send(head.pack(last, 7, 0) + b"end without a start")
    raw.send(head.pack(go_on, 0, 0) + b"start")
    raw.send(head.pack(last, 6, 0) + b"after a gap")
    raw.send(head.pack(go_on, 0, 0) + b"start without an end")
    raw.send(head.pack(go_on, 0, 0) + b"a")
    raw.send(head.pack(last, 1, 0) + b"b")
    await until(lambda: b.frames)
    assert b.frames == [("a", b"ab")]


async def test_pieces_without_end_take_no_memory(ends):
    a, b = ends("a"), ends("b")
    await connect(a, b)
    raw = a.sockets.connections["b"].socket
    raw.setblocking(True)
    piece = bytes(100_000)
    for k in range(30):
        mark = local_connection.PIECE_MARK
        head = local_connection.PACKET_HEAD.pack(mark, k * len(piece), 0)
        await asyncio.to_thread(raw.send, head + piece)
    raw.setblocking(False)
    a.send("b", VERSION)
    held = b.sockets.connections["a"].pieces
    assert len(held) <= FRAME_FORMAT.max_bytes + len(piece)
    await until(lambda: b.frames)


def test_a_network_namespace_of_its_own_is_another_machine():
    program = (
        "from crazychoir.bus.network.local_address import find_machine; "
        "print(find_machine())"
    )
    alone = subprocess.run(
        ["unshare", "--net", sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=False,
    )
    if alone.returncode:
        pytest.skip(f"no network namespace can be made: {alone.stderr.strip()}")
    machine = local_address.find_machine()
    assert alone.stdout.strip() not in ("", machine)
    assert alone.stdout.partition("/")[0] == machine.partition("/")[0]


@pytest.mark.parametrize("fault", ["machine", "path", "rename"])
async def test_without_a_socket_the_network_is_used(ends, monkeypatch, fault, caplog):
    caplog.set_level("INFO")
    if fault == "machine":
        monkeypatch.setattr(local_sockets, "find_machine", lambda: "")
    elif fault == "rename":
        monkeypatch.setattr(os, "rename", Mock(side_effect=OSError("no room")))
    else:
        long = Path(os.environ[RUNTIME_VARIABLE]) / ("x" * 100)
        monkeypatch.setattr(local_sockets, "find_socket_path", lambda identity: long)
    a = ends("a")
    assert a.sockets.address.path == ""
    assert "reached over the network" in caplog.text
    a.sockets.reach("b", LocalAddress("", "x"))
    assert "b" not in a.sockets.connections
