"""The fork server makes processes that are like any other child of the run."""

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from crazychoir.errors import ProcessFailed
from crazychoir.launch import fork_server
from crazychoir.launch.fork_server import ForkedProcess, ForkServer
from crazychoir.launch.processes import SwarmLauncher

SERVER = """
from crazychoir.cli.fly.process_command import limit_matrix_threads
limit_matrix_threads()
import socket, sys, threading, time
import numpy.random
from crazychoir.launch.process.ending import end_after_parent
from crazychoir.launch.process.forking import serve_forks

def prepare():
    print("prepared", flush=True)
    {prepare}

def preload(request):
    is_asked = "load tabnanny" in request.words
    if is_asked:
        import tabnanny
    return is_asked

end_after_parent()
with socket.socket(fileno=int(sys.argv[1])) as requests:
    program = serve_forks(requests, prepare, preload)
if program is not None:
    program.run()
"""
PROGRAM = """
import os, signal, sys, time
from pathlib import Path

def main():
    {main}
"""
RUN = """
import asyncio, os
from crazychoir.launch import fork_server

fork_server.SERVER_MODULE = "small_server"

async def run():
    with fork_server.ForkServer() as server:
        child = await server.start("small_program")
        assert await child.stdout.readline() == b"ready\\n"
        print(child.pid, server.pid, flush=True)
        os.kill(os.getpid(), 9)

asyncio.run(run())
"""
PAUSE = "print('ready', flush=True); signal.pause()"


@pytest.fixture
def write_program(tmp_path, monkeypatch):
    """Let a small server and a program with this body take the places of the real ones."""
    monkeypatch.setattr(fork_server, "SERVER_MODULE", "small_server")
    places = [str(tmp_path), str(Path(fork_server.__file__).parents[2])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(places))

    def write(main, prepare="pass"):
        (tmp_path / "small_server.py").write_text(SERVER.format(prepare=prepare))
        (tmp_path / "small_program.py").write_text(PROGRAM.format(main=main))

    return write


async def run_program(*words):
    """Run the program to its end; return its exit code and its output."""
    with ForkServer() as server:
        child = await server.start("small_program", *words)
        output = (await child.stdout.read()).decode()
        return await child.wait(), output


def is_running(pid):
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    return False


@pytest.mark.parametrize(
    ("main", "code", "output"),
    [
        ("print('hello')", 0, "hello\n"),
        ("print('out'); sys.exit(3)", 3, "out\n"),
        ("sys.exit('no such swarm')", 1, "no such swarm\n"),
        ("sys.exit()", 0, ""),
        ("sys.stderr.write('error'); sys.exit(256 + 7)", 7, "error"),
        (
            "print('last words'); sys.stdout.flush(); os.kill(os.getpid(), 9)",
            -9,
            "last words\n",
        ),
        ("os.kill(os.getpid(), 15)", -15, ""),
    ],
)
async def test_exit_code_and_output_arrive(write_program, main, code, output):
    write_program(main)
    assert await run_program() == (code, output)


async def test_program_that_raises_prints_its_traceback(write_program):
    write_program("raise ValueError('no drone')")
    code, output = await run_program()
    assert code == 1
    assert output.startswith("Traceback")
    assert output.endswith("ValueError: no drone\n")


async def test_missing_module_is_named():
    with ForkServer() as server:
        child = await server.start("no_such_module")
        output = (await child.stdout.read()).decode()
        assert await child.wait() == 1
    assert output.endswith("ModuleNotFoundError: No module named 'no_such_module'\n")


async def test_server_waits_for_a_thread_that_is_to_end(write_program):
    write_program(
        "print('on')", "threading.Thread(target=time.sleep, args=(0.2,)).start()"
    )
    assert await run_program() == (0, "on\n")


async def test_server_has_one_thread_whatever_the_environment_says(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    with ForkServer() as server:
        child = await server.start("no_such_module")
        assert b"no_such_module" in await child.stdout.read()


async def test_environment_of_any_size_arrives(write_program, monkeypatch):
    for name in "ABCDEF":
        monkeypatch.setenv(f"LARGE_{name}", 100_000 * "x")
    write_program("print(sum(len(value) for value in os.environ.values()) > 600_000)")
    with ForkServer() as server:
        child = await server.start("small_program")
        assert await child.stdout.read() == b"True\n"


async def test_process_has_no_socket_of_the_server(write_program):
    """The server would not notice the end of the run while a process has its socket."""
    links = (
        "[os.readlink(f'/proc/self/fd/{n}') for n in os.listdir('/proc/self/fd')[:-1]]"
    )
    write_program(f"print(sum('socket' in link for link in {links}))")
    with ForkServer() as server:
        held = await server.start("small_program", is_held=True)
        child = await server.start("small_program")
        assert await child.stdout.read() == b"0\n"
        server.release()
        assert await held.stdout.read() == b"0\n"


async def test_process_that_cannot_be_watched_is_ended(write_program, monkeypatch):
    def fails(pid):
        pids.append(pid)
        raise OSError(24, "Too many open files")

    pids = []
    write_program(PAUSE)
    monkeypatch.setattr(os, "pidfd_open", fails)
    with (
        ForkServer() as server,
        pytest.raises(ProcessFailed, match="Too many open files"),
    ):
        await server.start("small_program")
    with pytest.raises(ProcessLookupError):
        os.kill(pids[0], 0)


async def test_output_of_a_server_that_refuses_a_process_ends(write_program):
    write_program(PAUSE)
    said = []
    with ForkServer() as server:
        launcher = SwarmLauncher(server, Path("swarm.toml"))

        async def fail():
            async with launcher.pass_on_own_output(said.append):
                raise ProcessFailed("a process", "the system allows none")

        with pytest.raises(ProcessFailed):
            await asyncio.wait_for(fail(), 10.0)


async def test_process_has_the_words_the_folder_and_the_environment_of_the_run(
    write_program, tmp_path, monkeypatch
):
    write_program("print(sys.argv[1:], os.getcwd(), os.environ.get('COLOUR'))")
    with ForkServer() as server:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setenv("COLOUR", "grün")
        child = await server.start("small_program", "--id", "ü", "\udcff")
        output = (await child.stdout.read()).decode()
        await child.wait()
    assert output == f"['--id', 'ü', '\\udcff'] {tmp_path} grün\n"


async def test_process_is_a_child_of_the_run_in_a_session_of_its_own(write_program):
    write_program("print(os.getpid(), os.getppid(), os.getsid(0))")
    code, output = await run_program()
    pid, parent, session = map(int, output.split())
    assert (parent, session, code) == (os.getpid(), pid, 0)


async def test_lists_of_processes_show_its_command_line(write_program):
    words = [f"--option-{k}" for k in range(40)]
    write_program("print(Path('/proc/self/cmdline').read_bytes())")
    _, short = await run_program("--id", "3")
    _, long = await run_program(*words)
    expected = f"{sys.executable} -m small_program"
    assert f"{expected} --id 3" in short
    assert f"{expected} {' '.join(words)}" in long


async def test_processes_draw_different_random_numbers(write_program):
    write_program("import random, numpy; print(random.random(), numpy.random.random())")
    with ForkServer() as server:
        children = [await server.start("small_program") for _ in range(2)]
        one, other = [(await child.stdout.read()).split() for child in children]
        await asyncio.gather(*(child.wait() for child in children))
    assert one[0] != other[0]
    assert one[1] != other[1]


async def test_many_processes_start_at_once_and_end_in_any_order(write_program):
    write_program(
        "time.sleep(0.2 - float(sys.argv[1]) / 100); sys.exit(int(sys.argv[1]))"
    )
    with ForkServer() as server:
        starts = [server.start("small_program", str(k)) for k in range(12)]
        children = await asyncio.gather(*starts)
        for child in children:
            await child.stdout.read()
        codes = [await child.wait() for child in children]
    assert codes == list(range(12))


async def test_held_processes_run_once_they_are_released(write_program):
    write_program("print('ran', flush=True)")
    with ForkServer() as server:
        held = [await server.start("small_program", is_held=True) for _ in range(3)]
        free = await server.start("small_program")
        assert await free.stdout.read() == b"ran\n"
        reading = [asyncio.create_task(child.stdout.read()) for child in held]
        _, waiting = await asyncio.wait(reading, timeout=0.3)
        assert len(waiting) == 3
        server.release()
        assert [await one for one in reading] == [b"ran\n"] * 3
        assert [await child.wait() for child in held] == [0] * 3


async def test_held_processes_end_with_their_server_and_cannot_be_released(
    write_program,
):
    write_program("print('ran')")
    with ForkServer() as server:
        held = [await server.start("small_program", is_held=True) for _ in range(3)]
        os.kill(server.pid, signal.SIGKILL)
        async with asyncio.timeout(30.0):
            assert [await child.wait() for child in held] == [1] * 3
        assert [await child.stdout.read() for child in held] == [b""] * 3
        with pytest.raises(ProcessFailed, match=r"^the fork server: "):
            server.release()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
async def test_signal_ends_a_held_process_without_a_word(write_program, number):
    write_program("print('ran')")
    with ForkServer() as server:
        child = await server.start("small_program", is_held=True)
        child.send_signal(number)
        assert await child.wait() == -number
        async with server.open_output() as output:
            assert await output.readline() == b"prepared\n"
            server.release()
            other = await server.start("small_program")
            assert await other.wait() == 0
            os.kill(server.pid, signal.SIGKILL)
            assert await output.read() == b""


async def test_program_gets_the_signal_of_the_keyboard_as_python_does(write_program):
    write_program("os.kill(os.getpid(), signal.SIGINT); time.sleep(30)")
    code, output = await run_program()
    assert code == 1
    assert output.endswith("KeyboardInterrupt\n")


async def test_end_is_noticed_where_the_system_keeps_no_exit_codes(write_program):
    write_program("sys.exit(3)")
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        async with asyncio.timeout(30.0):
            code, _ = await run_program()
    finally:
        signal.signal(signal.SIGCHLD, before)
    assert code == 255


def start_program():
    """Start a program that waits for the end of its input."""
    return subprocess.Popen(
        [sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE
    )


def end_program(program):
    """End the program; the event loop of this test does not notice it meanwhile."""
    program.stdin.close()
    program.wait()


async def test_process_that_has_left_nothing_has_ended():
    program = start_program()
    end_program(program)
    child = ForkedProcess(program.pid, asyncio.StreamReader())
    child.kill()  # has no effect
    assert await child.wait() == 255


def test_process_that_has_left_nothing_need_not_be_ended():
    program = start_program()
    end_program(program)
    fork_server._end_process(program.pid)  # raises nothing


async def test_signal_comes_too_late_where_the_system_keeps_no_exit_codes():
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        program = start_program()
        child = ForkedProcess(program.pid, asyncio.StreamReader())
        end_program(program)
        child.kill()
        assert await child.wait() == 255
    finally:
        signal.signal(signal.SIGCHLD, before)


@pytest.mark.parametrize("usual", [signal.SIG_DFL, signal.SIG_IGN])
async def test_signals_reach_the_process(write_program, usual):
    write_program(PAUSE)
    before = signal.signal(signal.SIGHUP, usual)
    try:
        with ForkServer() as server:
            child = await server.start("small_program")
            await child.stdout.readline()
            child.send_signal(signal.SIGHUP)
            async with asyncio.timeout(30.0):
                assert await child.wait() == -signal.SIGHUP
            child.kill()  # has no effect
            await child.stdout.read()
    finally:
        signal.signal(signal.SIGHUP, before)


async def test_processes_go_on_without_their_server_and_no_other_can_start(
    write_program,
):
    write_program(PAUSE)
    with ForkServer() as server:
        child = await server.start("small_program")
        await child.stdout.readline()
        os.kill(server.pid, signal.SIGKILL)
        with pytest.raises(ProcessFailed, match=r"^the fork server: "):
            await server.start("small_program")
        assert child.returncode is None
        child.kill()
        assert await child.wait() == -signal.SIGKILL
        await child.stdout.read()


async def test_server_that_fails_says_why(write_program):
    write_program("pass", prepare="raise ValueError('no law')")
    with ForkServer() as server:
        with pytest.raises(ProcessFailed, match=r"^the fork server: it has ended$"):
            await server.start("small_program")
        async with server.open_output() as output:
            assert (await output.read()).endswith(b"ValueError: no law\n")


async def test_server_with_a_thread_refuses_to_fork(write_program):
    thread = "threading.Thread(target=time.sleep, args=(60,), daemon=True).start()"
    write_program("pass", prepare=thread)
    with ForkServer() as server:
        with pytest.raises(ProcessFailed, match="it has ended"):
            await server.start("small_program")
        async with server.open_output() as output:
            said = await output.read()
    assert b"RuntimeError: the fork server has 2 threads; allowed: 1" in said


async def test_server_is_prepared_once_before_its_first_process(write_program):
    write_program("pass")
    with ForkServer() as server:
        server.prepare()
        async with server.open_output() as output:
            assert await output.readline() == b"prepared\n"
            for _ in range(2):
                child = await server.start("small_program")
                await child.stdout.read()
                await child.wait()
            os.kill(server.pid, signal.SIGKILL)
            assert await output.read() == b""


async def test_process_and_later_ones_have_what_the_server_loads_for_its_request(
    write_program,
):
    write_program("print('tabnanny' in sys.modules)")
    with ForkServer() as server:
        for words, is_there in (((), False), (("load tabnanny",), True), ((), True)):
            child = await server.start("small_program", *words)
            assert await child.stdout.read() == f"{is_there}\n".encode()
            await child.wait()


async def test_cancelled_start_leaves_no_process(write_program):
    write_program(PAUSE, prepare="time.sleep(60.0)")
    with ForkServer() as server:
        starting = asyncio.create_task(server.start("small_program"))
        async with server.open_output() as output:
            await output.readline()
        began = time.monotonic()
        starting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await starting
        assert time.monotonic() - began < 30.0
        with pytest.raises(ProcessFailed):
            await server.start("small_program")


@pytest.mark.parametrize("ignored", [False, True], ids=["", "with nohup"])
def test_server_and_processes_end_when_the_run_is_killed(write_program, ignored):
    write_program(
        "from crazychoir.launch.process.ending import end_after_parent; "
        f"end_after_parent(); {PAUSE}"
    )
    command = [sys.executable, "-c", RUN]
    if ignored:
        command = ["nohup", *command]
    run = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    assert run.returncode == -signal.SIGKILL
    pids = [int(word) for word in run.stdout.split()]
    assert len(pids) == 2
    ends = time.monotonic() + 20.0
    while any(map(is_running, pids)):
        assert time.monotonic() < ends, "still running"
        time.sleep(0.01)
