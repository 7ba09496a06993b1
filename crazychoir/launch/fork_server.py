"""The fork server of a run, as the run uses it: it makes processes that have nothing to import.

A process of a swarm imports for more than a second and loads compiled laws for half a second. The
fork server is a process that does this once, while the run checks its swarm file. Then it forks
each process that the run asks for. The memory of what was loaded is shared among them.

    run ── fork server ── middle process ── process of the swarm
     └─────────────────── adopts it when the middle process has ended

The run adopts the processes: it is their parent as if it had started them itself (it is a "child
subreaper", see prctl(2)). So it sees their exit codes, and they notice its end, also when the fork
server is gone. Each process has a session and an output of its own. The other half of the server
is launch/process/forking.py.

multiprocessing has a fork server too. Its processes are children of that server, their output
cannot be redirected, and one process has only one such server, which a user's program may need.
"""

import asyncio
import contextlib
import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator
from dataclasses import asdict, dataclass
from typing import BinaryIO, Self

from crazychoir.errors import ProcessFailed
from crazychoir.files.path_texts import child_environment

PR_SET_CHILD_SUBREAPER = 36
"""Option of prctl(2): this process adopts the processes below it that lose their parent."""
SERVER_MODULE = "crazychoir.cli.fly.fork_server"
"""Module that runs as the fork server."""
SERVER_NAME = "the fork server"
"""Name of the server in errors."""
UNKNOWN_EXIT_CODE = 255
"""Exit code where the system has kept none."""
ANSWER_SIZE = 1 << 12
"""Most bytes of an answer of the server."""
FORK_REQUEST = b"fork"
"""Request for a process; two file descriptors come with it, for its output and for what is to run."""
WITHOUT_PROCESS = b"release"
"""Request without a process: the server prepares itself, and releases the processes that it holds."""


@dataclass(frozen=True, slots=True)
class ForkRequest:
    """What the run asks the fork server for: a process that runs a module as a program."""

    module: str
    """Module with a function `main` that reads the command line."""
    words: tuple[str, ...]
    """Words of the command line."""
    folder: str
    """Working directory."""
    environment: dict[str, str]
    """Environment variables."""
    is_held: bool
    """Whether the process waits for `release` before it runs the module."""

    def encode(self) -> bytes:
        """Return the request as bytes."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Return the request of these bytes."""
        return cls(**json.loads(data))


class ForkedProcess:
    """A process that the fork server has made and that this process has adopted.

    It has the attributes and methods of asyncio's subprocesses.

    Attributes:
    pid: its number
    stdout: its standard output and standard error
    returncode: its exit code, -N if signal N has ended it, None while it runs
    """

    def __init__(self, pid: int, stdout: asyncio.StreamReader) -> None:
        self.pid = pid
        self.stdout = stdout
        self.returncode: int | None = None
        self._has_ended = asyncio.Event()
        try:
            self._descriptor = os.pidfd_open(pid)
        except ProcessLookupError:  # it has ended, and this process ignores SIGCHLD
            self.returncode = UNKNOWN_EXIT_CODE
            self._has_ended.set()
        else:
            asyncio.get_running_loop().add_reader(self._descriptor, self._reap)

    def _reap(self) -> None:
        asyncio.get_running_loop().remove_reader(self._descriptor)
        try:
            _, status = os.waitpid(self.pid, 0)
        except ChildProcessError:  # this process ignores SIGCHLD
            self.returncode = UNKNOWN_EXIT_CODE
        else:
            self.returncode = os.waitstatus_to_exitcode(status)
        os.close(self._descriptor)
        self._has_ended.set()

    async def wait(self) -> int | None:
        """Wait for its end; return its exit code."""
        await self._has_ended.wait()
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""
        if self.returncode is None:
            # It may have ended, and this process ignores SIGCHLD.
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._descriptor, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


class ForkServer:
    """Starts the fork server, and asks it for processes, while its `with` lasts.

    Processes that run at the end of the `with` go on.
    """

    def __enter__(self) -> Self:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        self._requests = ours
        self._one_at_a_time = asyncio.Lock()
        _adopt_orphans(True)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", SERVER_MODULE, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                env=child_environment(),
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        return self

    def __exit__(self, *exception: object) -> None:
        self._requests.close()
        self.end()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        _adopt_orphans(False)

    def end(self) -> None:
        """End the server; its processes that run go on."""
        self._process.kill()

    @property
    def pid(self) -> int:
        """Number of the server's process."""
        return self._process.pid

    @contextlib.asynccontextmanager
    async def open_output(self) -> AsyncIterator[asyncio.StreamReader]:
        """Yield the output of the server itself: lines about compiling, and errors."""
        assert self._process.stdout is not None  # noqa: S101 - it was asked for
        reader, transport = await _open_reader(os.dup(self._process.stdout.fileno()))
        try:
            yield reader
        finally:
            transport.close()

    def prepare(self) -> None:
        """Let the server compile the laws that are not kept on disk.

        Before this call the server only imports, and loads the laws that are kept.
        """
        with contextlib.suppress(OSError):  # `start` reports a server that has ended
            self._requests.send(WITHOUT_PROCESS)

    async def start(
        self, module: str, *words: str, is_held: bool = False
    ) -> ForkedProcess:
        """Start a process that runs a module, in its own session.

        module: module with a function `main` that reads the command line
        words: words of its command line
        is_held: whether the process waits for `release` before it runs the module
        Raises ProcessFailed if there is no such process, because the server has ended.
        """
        read, write = os.pipe()
        try:
            request = ForkRequest(
                module, words, os.getcwd(), child_environment(), is_held
            )
            async with self._one_at_a_time:
                answer = await self._ask(request, write)
        except BaseException:
            os.close(read)
            raise
        finally:
            os.close(write)
        if not answer.isdecimal():
            os.close(read)
            raise ProcessFailed(SERVER_NAME, answer)
        transport: asyncio.ReadTransport | None = None
        try:
            reader, transport = await _open_reader(read)
            return ForkedProcess(int(answer), reader)
        except BaseException as error:
            if transport is not None:
                transport.close()
            _end_process(int(answer))
            if isinstance(error, OSError):
                reason = error.strerror or str(error)
                raise ProcessFailed(SERVER_NAME, reason) from error
            raise

    def release(self) -> None:
        """Let all held processes run.

        Raises ProcessFailed if the server has ended: then they have ended too.
        """
        try:
            self._requests.send(WITHOUT_PROCESS)
        except OSError as error:
            reason = error.strerror or str(error)
            raise ProcessFailed(SERVER_NAME, reason) from error

    async def _ask(self, request: ForkRequest, output: int) -> str:
        """Return the number of the new process, or the reason why there is none.

        If this is cancelled, the server ends, and so does the new process.
        """
        try:
            with _memory_file(request.encode()) as program:
                descriptors = [output, program.fileno()]
                socket.send_fds(self._requests, [FORK_REQUEST], descriptors)
        except OSError as error:
            return error.strerror or str(error)
        answering = asyncio.create_task(self._receive())
        try:
            return await asyncio.shield(answering)
        except asyncio.CancelledError:
            self._process.kill()
            answer = await answering
            if answer.isdecimal():
                _end_process(int(answer))
            raise

    async def _receive(self) -> str:
        """Return the answer of the server."""
        loop = asyncio.get_running_loop()
        try:
            answer = await loop.sock_recv(self._requests, ANSWER_SIZE)
        except OSError as error:
            return error.strerror or str(error)
        return answer.decode() or "it has ended"


def _memory_file(content: bytes) -> BinaryIO:
    """Return a file in memory with this content, at its beginning."""
    file = os.fdopen(os.memfd_create("fork request"), "w+b", buffering=0)
    file.write(content)
    file.seek(0)
    return file


def _end_process(number: int) -> None:
    """End an adopted process at once."""
    # Where this process ignores SIGCHLD, nothing is left of a process that has ended.
    with contextlib.suppress(ProcessLookupError, ChildProcessError):
        os.kill(number, signal.SIGKILL)
        os.waitpid(number, 0)


def _adopt_orphans(wanted: bool) -> None:
    """Let this process adopt the processes below it that lose their parent, or no longer."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, int(wanted))


async def _open_reader(
    descriptor: int,
) -> tuple[asyncio.StreamReader, asyncio.ReadTransport]:
    """Return a reader of a pipe, and its transport, which closes the pipe at its end."""
    reader = asyncio.StreamReader()
    transport, _ = await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader),
        os.fdopen(descriptor, "rb", buffering=0),
    )
    return reader, transport
