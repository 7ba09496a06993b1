"""The fork server of a run, from inside: it forks a process for each request.

The other half is launch/fork_server.py, which says what it is for.

A fork copies memory, but only one thread. A thread of a library that is lost in this way may have
held a lock, on which the new process would wait for ever. Therefore the server has one thread, and
sessions, event loops and logging begin in the new process.
"""

import contextlib
import ctypes
import gc
import importlib
import os
import random
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from crazychoir.launch.fork_server import WITHOUT_PROCESS, ForkRequest

THREADS_FOLDER = Path("/proc/self/task")
"""Folder with an entry for each thread of this process."""
THREAD_LOOK_INTERVAL = 0.002
"""s: time between two looks at the threads."""
MOST_THREAD_LOOKS = 1000
"""Looks after which a thread counts as endless."""
STATE_FILE = Path("/proc/self/stat")
"""File with the state of this process, see proc(5)."""
ARGUMENTS_START = 45
"""Field of STATE_FILE, after the name: the address of the first word of the command line."""
ENVIRONMENT_END = 48
"""Field of STATE_FILE, after the name: the end of the environment, which follows the command line."""
STANDARD_OUTPUTS = (1, 2)
"""File descriptors of standard output and standard error."""
MOST_DESCRIPTORS = 2
"""File descriptors that come with a request for a process."""
PROCESS_NUMBER_SIZE = 32
"""Most bytes of the number of a process as text."""


@dataclass(frozen=True, slots=True)
class ForkedProgram:
    """What a forked process is to run."""

    request: ForkRequest
    """The request of the run."""
    output: int
    """File descriptor for its standard output and standard error."""

    def run(self) -> NoReturn:
        """Run the module as if Python had just been started with it, and exit."""
        code = 1
        try:
            self._take_over()
            module = importlib.import_module(self.request.module)
            module.main()
            code = 0
        except SystemExit as ended:
            code = _read_exit_code(ended)
        except BaseException:  # noqa: BLE001 - Python itself prints any error in this way
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)

    def _take_over(self) -> None:
        """Replace what this process has from the fork server."""
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for standard in STANDARD_OUTPUTS:
            os.dup2(self.output, standard)
        os.close(self.output)
        os.environ.clear()
        os.environ.update(self.request.environment)
        os.chdir(self.request.folder)
        sys.argv = [self.request.module, *self.request.words]
        _show_command_line(sys.executable, "-m", *sys.argv)
        _forget_random_state()


def serve_forks(
    requests: socket.socket,
    prepare: Callable[[], None],
    preload: Callable[[ForkRequest], bool],
) -> ForkedProgram | None:
    """Fork a process for each request until the run has ended.

    requests: socket with the requests of the run
    prepare: loads what all processes need; called before the first request is answered
    preload: loads what the process of a request needs and later ones need too, if it is not loaded;
        returns whether it has loaded anything
    Returns in each forked process the program that it is to run; close `requests` before. Returns None
    in the server, at its end.
    """
    is_prepared = False
    held: list[socket.socket] = []
    while True:
        data, descriptors, _, _ = socket.recv_fds(
            requests, len(WITHOUT_PROCESS), MOST_DESCRIPTORS
        )
        if not data:
            return None
        if not is_prepared:
            prepare()
            _get_ready_to_fork()
            is_prepared = True
        if not descriptors:
            _release(held)
            held = []
            continue
        output, wanted = descriptors
        with os.fdopen(wanted, "rb") as file:
            program = ForkedProgram(ForkRequest.decode(file.read()), output)
        if preload(program.request):
            _get_ready_to_fork()
        waiting = _fork_for_adoption(requests, held)
        if waiting is None:
            return program
        os.close(program.output)
        if program.request.is_held:
            held.append(waiting)
        else:
            _release([waiting])


def _get_ready_to_fork() -> None:
    """Let this process notice the ends of the processes below it, and keep its memory shared.

    The garbage collector would copy the memory of each object that it visits.

    Raises RuntimeError if this process has more than one thread.
    """
    _wait_for_threads()
    for number in (signal.SIGCHLD, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)  # the run may ignore it
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # it ends a process that waits
    gc.collect()
    gc.freeze()


def _wait_for_threads() -> None:
    """Wait until all threads but this one have ended: a thread that is to end needs a moment.

    Raises RuntimeError if there are others at the last look.
    """
    for _ in range(MOST_THREAD_LOOKS):
        threads = len(list(THREADS_FOLDER.iterdir()))
        if threads == 1:
            return
        time.sleep(THREAD_LOOK_INTERVAL)
    raise RuntimeError(f"the fork server has {threads} threads; allowed: 1")


def _fork_for_adoption(
    requests: socket.socket, held: list[socket.socket]
) -> socket.socket | None:
    """Fork a process that the run adopts, and send its number to the run.

    held: sockets of the processes that wait
    Returns in the server the socket of the new process, which waits. Returns None in the new
    process, once it is released. If the server ends before, the new process ends too.
    """
    ours, theirs = socket.socketpair()
    with theirs:
        middle = os.fork()
        if middle == 0:
            for one in (ours, *held):  # else they stay open when the server ends
                one.close()
            _fork_and_leave(theirs)
            return None
    number = ours.recv(PROCESS_NUMBER_SIZE)
    os.waitpid(middle, 0)  # the run has adopted the new process
    requests.send(number or b"the system allows no further process")
    return ours


def _release(waiting: list[socket.socket]) -> None:
    """Let processes run that wait at the other ends of these sockets."""
    for one in waiting:
        with one, contextlib.suppress(OSError):  # it was killed meanwhile
            one.send(b"go")


def _fork_and_leave(server: socket.socket) -> None:
    """Fork a process, send its number to the server, and end; return in the new process.

    The new process waits here until the server releases it.
    """
    try:
        number = os.fork()
    except OSError:
        os._exit(1)
    if number:
        server.send(str(number).encode())
        os._exit(0)
    if not server.recv(PROCESS_NUMBER_SIZE):
        os._exit(1)


def _show_command_line(*words: str) -> None:
    """Show this command line in lists of processes.

    It is written over the command line and the environment with which the server was started. Both
    are in use no more: Python has copied them, and this process has set its environment anew.
    """
    fields = STATE_FILE.read_text("utf-8", "replace").rpartition(")")[2].split()
    start = int(fields[ARGUMENTS_START])
    room = int(fields[ENVIRONMENT_END]) - start
    if start <= 0 or room <= 0:  # a system may hide where they are
        return
    text = os.fsencode(" ".join(words))[: room - 1]
    ctypes.memset(start, 0, room)
    ctypes.memmove(start, text, len(text))


def _forget_random_state() -> None:
    """Give this process random numbers of its own: those of numpy would be the same in all."""
    shared = sys.modules.get("numpy.random")
    if shared is not None:
        shared.seed(random.SystemRandom().getrandbits(32))


def _read_exit_code(ended: SystemExit) -> int:
    """Return the exit code of a program, and print the text with which it has ended."""
    if ended.code is None:
        return 0
    if isinstance(ended.code, int):
        return ended.code & 0xFF
    sys.stderr.write(f"{ended.code}\n")
    return 1
