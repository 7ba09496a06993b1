"""Start programs on this machine together, read their answers as JSON lines, and end them all."""

import contextlib
import json
import os
import queue
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from typing import Any, Self

from crazychoir.files.path_texts import child_environment

EXIT_LOOK_PERIOD = 1.0
"""s without an answer after which the programs are asked whether they still run."""


class ProgramEnded(TimeoutError):
    """A program has ended before its answer.

    number: index of the program in the list of commands
    last_words: last line of its output that was not an answer
    """

    def __init__(self, number: int, last_words: str) -> None:
        self.number = number
        super().__init__(
            "a process has ended before its answer"
            + (f": {last_words}" if last_words else "")
        )


class ProgramGroup:
    """Programs that are started together and answer with lines that are JSON objects.

    The last line of each program that is not JSON is kept, for error texts.
    A program must end when its standard input ends. Then none outlives this process, even after a
    crash. At the end of the `with` block all programs are killed, with the processes that they have
    started.
    """

    def __init__(self, commands: list[list[str]]) -> None:
        self._commands = commands
        self._processes: list[subprocess.Popen[str]] = []
        self._lines: queue.SimpleQueue[tuple[int, str]] = queue.SimpleQueue()
        self._last_words = ["" for _ in commands]

    def __enter__(self) -> Self:
        pipe = subprocess.PIPE
        for number, command in enumerate(self._commands):
            process = subprocess.Popen(
                command,
                stdin=pipe,
                stdout=pipe,
                stderr=subprocess.STDOUT,
                encoding="utf-8",
                errors="replace",
                env=child_environment(),
                start_new_session=True,
            )
            self._processes.append(process)
            threading.Thread(
                target=self._read, args=(number, process), daemon=True
            ).start()
        return self

    def _read(self, number: int, process: "subprocess.Popen[str]") -> None:
        with contextlib.suppress(ValueError, OSError):
            for line in process.stdout or ():
                if line.startswith("{"):
                    self._lines.put((number, line))
                elif line.strip():
                    self._last_words[number] = line.strip()
        self._lines.put((number, ""))

    def tell(self, word: str) -> None:
        """Write one line to every program."""
        for process in self._processes:
            with contextlib.suppress(OSError):  # `answers` reports a program that ended
                if process.stdin is not None:
                    process.stdin.write(word + "\n")
                    process.stdin.flush()

    def answers(
        self, count: int, patience: float, complaint: str
    ) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield the next `count` answers, each with the number of its program.

        count: number of answers
        patience: s, time limit for all of them
        complaint: what the missing programs have not done, for the error text
        Raises TimeoutError after `patience` s, and ProgramEnded if a program ends instead.
        """
        ends = time.perf_counter() + patience
        for done in range(count):
            try:
                number, line = self._next_line(ends)
            except queue.Empty:
                raise TimeoutError(
                    f"{count - done} of {count} processes {complaint} in {patience:g} s"
                ) from None
            if not line:
                raise ProgramEnded(number, self._last_words[number])
            yield number, json.loads(line)

    def _next_line(self, ends: float) -> tuple[int, str]:
        """Return the number of a program and its next answer, "" if it has ended.

        The output of a program that has ended stays open while a process that it has started lives.

        ends: s, end of the wait on the clock of perf_counter
        Raises queue.Empty at the end of the wait.
        """
        while True:
            rest = max(0.0, ends - time.perf_counter())
            try:
                return self._lines.get(timeout=min(rest, EXIT_LOOK_PERIOD))
            except queue.Empty:
                for number, process in enumerate(self._processes):
                    if process.poll() is not None:
                        return number, ""
                if rest <= EXIT_LOOK_PERIOD:
                    raise

    def __exit__(self, *exception: object) -> None:
        for process in self._processes:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        for process in self._processes:
            process.wait(5.0)
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    with contextlib.suppress(OSError):
                        stream.close()
