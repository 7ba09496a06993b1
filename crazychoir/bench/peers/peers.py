"""What the programs of the benchmarks share: the argument, ready and go, one answer, a window of time.

Every program gets one JSON argument, prints {"ready": true}, starts at a line "go" and answers
with one JSON line.
"""

import json
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

PROGRAM_TIME_LIMIT = 150.0
"""Seconds after which a program ends itself."""


def specification() -> dict[str, Any]:
    """Return the argument of the program: neighbors, warm, seconds, and what the program needs.

    From this call on `PROGRAM_TIME_LIMIT` counts. If the argument has a `core`, this process and all its
    later threads are bound to it.
    """
    giving_up = threading.Timer(PROGRAM_TIME_LIMIT, os._exit, (1,))
    giving_up.daemon = True
    giving_up.start()
    found: dict[str, Any] = json.loads(sys.argv[1])
    if "core" in found:
        os.sched_setaffinity(0, {found["core"]})
    found["neighbors"] = {int(i): tuple(js) for i, js in found["neighbors"].items()}
    return found


def say(answer: dict[str, Any]) -> None:
    """Print one line for the bench."""
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


def wait_for_go() -> None:
    """Block until the bench says go; from then on, end when the bench ends."""
    if not sys.stdin.readline():
        os._exit(1)
    end_with_parent()


def end_with_parent() -> None:
    """End this process when its standard input ends."""
    threading.Thread(
        target=lambda: os._exit(len(sys.stdin.read())), daemon=True
    ).start()


def report(
    rounds: dict[int, int],
    spec: dict[str, Any],
    count_resent: Callable[[], int] | None = None,
) -> None:
    """Start a thread that waits `warm` s, then counts rounds and CPU for `seconds` s.

    It prints the result.
    count_resent: returns how many messages were sent again since the start; None if nothing counts them
    """
    thread = threading.Thread(
        target=_report, args=(rounds, spec, count_resent), daemon=True
    )
    thread.start()


def _report(
    rounds: dict[int, int],
    spec: dict[str, Any],
    count_resent: Callable[[], int] | None,
) -> None:
    time.sleep(spec["warm"])
    before = dict(rounds)
    resent = count_resent() if count_resent else 0
    cpu = time.process_time()
    began = time.perf_counter()
    time.sleep(spec["seconds"])
    after = dict(rounds)
    used = time.process_time() - cpu
    elapsed = time.perf_counter() - began
    done = {i: after[i] - before[i] for i in rounds}
    messages = sum(done[i] * len(spec["neighbors"][i]) for i in rounds)
    answer = {
        "rounds_per_s": min(done.values()) / elapsed,
        "messages_per_s": messages / elapsed,
        "cores": used / elapsed,
    }
    if count_resent:
        answer["resent_per_s"] = (count_resent() - resent) / elapsed
    say(answer)
