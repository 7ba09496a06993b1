"""Processes that help to compile laws: one a processor, each takes the next law until none is left.

The numbers of the laws lie in a pipe. Each process reads one number at a time, so no law is compiled
twice. A helper keeps its laws on disk, where the process that waits for them loads them.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager

LawName = tuple[str, str]
"""Module and qualified name of a law."""
LawNames = Sequence[LawName]
"""Names of laws."""
FEWEST_SHARED_LAWS = 8
"""With fewer laws to compile than this, a helper's imports take longer than its help saves."""
MOST_SHARED_LAWS = 4096
"""With more laws to compile than this, their numbers would not fit into the pipe."""
MOST_HELPERS = 7
"""Most processes that help."""
NUMBER_SIZE = 4
"""Bytes of the number of a law in the pipe."""
HELPER_MODULE = "crazychoir.numerics.compile_helper"
"""Module that runs as a helper."""
HELPER_END_TIMEOUT = 10.0
"""s: time for a helper to end after the last law."""


@contextmanager
def share_laws(names: LawNames) -> Iterator[Callable[[], int | None]]:
    """Start helpers that compile some of these laws.

    Gives a function that returns the number of the next law for this process, and None when all laws are taken.
    Helpers then still compile their last laws.
    """
    numbers = iter(range(len(names)))
    count = _count_helpers(len(names))
    if count == 0:
        yield lambda: next(numbers, None)
        return
    with ExitStack() as stack:
        reading, writing = os.pipe()
        stack.callback(os.close, reading)
        with os.fdopen(writing, "wb") as pipe:
            for number in numbers:
                pipe.write(number.to_bytes(NUMBER_SIZE, "little"))
        for _ in range(count):
            stack.callback(_end_helper, _start_helper(reading, names))
        yield lambda: take_number(reading)


def take_number(pipe: int) -> int | None:
    """Take a number out of the pipe; None if the pipe is empty.

    pipe: file descriptor
    """
    data = os.read(pipe, NUMBER_SIZE)
    return int.from_bytes(data, "little") if data else None


def _count_helpers(laws: int) -> int:
    """Return how many processes may help with so many laws."""
    if not FEWEST_SHARED_LAWS <= laws <= MOST_SHARED_LAWS:
        return 0
    if not hasattr(os, "sched_getaffinity"):
        return 0
    return min(len(os.sched_getaffinity(0)) - 1, MOST_HELPERS)


def _start_helper(pipe: int, names: LawNames) -> "subprocess.Popen[str]":
    """Start a helper; it says nothing, because this process reports all trouble with laws."""
    words = [sys.executable, "-P", "-m", HELPER_MODULE, str(pipe), str(os.getpid())]
    helper = subprocess.Popen(
        words,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        pass_fds=(pipe,),
        text=True,
    )
    assert helper.stdin is not None  # noqa: S101 - by PIPE
    helper.stdin.write(json.dumps(list(names)))
    helper.stdin.close()
    return helper


def _end_helper(helper: "subprocess.Popen[str]") -> None:
    """Wait for the end of a helper, after an error or an interrupt as well."""
    if sys.exc_info()[0] is not None:
        helper.kill()
    try:
        helper.wait(HELPER_END_TIMEOUT)
    except subprocess.TimeoutExpired:
        helper.kill()
        helper.wait()
