"""Processes that fly the runs of a sweep: each takes the next run when it has ended one."""

import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import IO, Self

from crazychoir.api.sweep_rows import Row, build_first_figures
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.files.path_texts import child_environment

WORKER_MODULE = "crazychoir.api.sweep_worker"
"""Module that runs as a worker."""
LOOK_INTERVAL = 0.2
"""Seconds after which the waiting thread looks for Ctrl-C."""
LONGEST_WORDS = 4096
"""Bytes of the end of a worker's output that are read for the reason of its end."""


class WorkerPool:
    """Flies runs in several processes, which end with the `with` block.

    A process that ends during a run gives that run a row with the reason, and is replaced.

    jobs: number of processes
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._runs: queue.SimpleQueue[tuple[str, SwarmConfig] | None] = (
            queue.SimpleQueue()
        )
        self._rows: queue.SimpleQueue[tuple[str, Row]] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._processes: list[subprocess.Popen[str]] = []
        self._is_ending = False

    def __enter__(self) -> Self:
        for _ in range(self._jobs):
            thread = threading.Thread(target=self._work, name="sweep", daemon=True)
            self._threads.append(thread)
            thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._is_ending = True
        for _ in self._threads:
            self._runs.put(None)
        for process in list(self._processes):
            _kill(process)
        for thread in self._threads:
            thread.join()

    def fly(self, runs: Sequence[tuple[str, SwarmConfig]]) -> Iterator[tuple[str, Row]]:
        """Fly the runs, and yield the key and the row of each as soon as it has ended.

        runs: key and swarm of each run
        """
        for run in runs:
            self._runs.put(run)
        for _ in runs:
            while True:
                # A wait without a limit would keep Ctrl-C from this thread.
                with suppress(queue.Empty):
                    yield self._rows.get(timeout=LOOK_INTERVAL)
                    break

    def _work(self) -> None:
        """Start a process, and give it runs until there are none."""
        with tempfile.TemporaryFile() as words:
            process, reason = self._begin(words)
            while (run := self._runs.get()) is not None and not self._is_ending:
                key, config = run
                if process is None:
                    process, reason = self._begin(words)
                if process is None:
                    self._rows.put((key, build_first_figures(False, reason)))
                    continue
                begin = words.seek(0, os.SEEK_END)
                row = _ask(process, config)
                if row is None:
                    row = _describe_end(process, words, begin)
                    _close(process)
                    process = None
                self._rows.put((key, row))
        if process is not None:
            _kill(process)
            _close(process)

    def _begin(self, words: IO[bytes]) -> "tuple[subprocess.Popen[str] | None, str]":
        """Start a process, which ends if the pool ends meanwhile.

        Returns it and "", or None and the reason why the system starts none.
        """
        try:
            process = _start(words)
        except OSError as error:
            return None, f"its process does not start: {error}"
        self._processes.append(process)
        if self._is_ending:  # the ending thread has not seen this process
            _kill(process)
        return process, ""


def _start(words: IO[bytes]) -> "subprocess.Popen[str]":
    """Start a worker, in a session of its own: Ctrl-C of the terminal does not reach it.

    words: file for its output beside the rows
    """
    return subprocess.Popen(
        [sys.executable, "-m", WORKER_MODULE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=words,
        encoding="utf-8",
        env=child_environment(),
        start_new_session=True,
    )


def _ask(process: "subprocess.Popen[str]", config: SwarmConfig) -> Row | None:
    """Let a worker fly this swarm; return the row, or None if it has ended."""
    try:
        assert process.stdin is not None  # noqa: S101 - it was asked for
        assert process.stdout is not None  # noqa: S101 - it was asked for
        process.stdin.write(json.dumps({"swarm": config.dumps()}) + "\n")
        process.stdin.flush()
        row: Row = json.loads(process.stdout.readline())
    except (OSError, ValueError):  # ValueError: no whole line
        return None
    return row


def _describe_end(
    process: "subprocess.Popen[str]", words: IO[bytes], begin: int
) -> Row:
    """Return the row of a run during which its worker has ended.

    words: file with the worker's output
    begin: where the output of this run begins
    """
    code = process.wait()
    end = words.seek(0, os.SEEK_END)
    words.seek(max(begin, end - LONGEST_WORDS))
    lines = words.read().decode(errors="replace").strip().splitlines()
    told = f": {lines[-1]}" if lines else ""
    return build_first_figures(False, f"its process has ended with code {code}{told}")


def _kill(process: "subprocess.Popen[str]") -> None:
    """End a worker at once, with what it has started."""
    if process.poll() is None:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def _close(process: "subprocess.Popen[str]") -> None:
    """Wait for the end of a worker, and close its streams."""
    process.wait()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with suppress(OSError):
                stream.close()
