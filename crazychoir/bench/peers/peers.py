"""What the programs of `bench exchange` share: a window of time in which a process counts its rounds and its CPU.

Every program gets one JSON argument, says {"ready": true}, starts at a line "go" and answers with one JSON line.
"""

import json
import os
import sys
import threading
import time
from typing import Any

PATIENCE = 150.0
"""s after which a program that nobody ends ends itself."""


def specification() -> dict[str, Any]:
    """The argument: neighbors, warm, seconds, and what the program needs; from here on `PATIENCE` counts.

    core: which this process is bound to, with all threads that it will have.
    """
    giving_up = threading.Timer(PATIENCE, os._exit, (1,))
    giving_up.daemon = True
    giving_up.start()
    found: dict[str, Any] = json.loads(sys.argv[1])
    if "core" in found:
        os.sched_setaffinity(0, {found["core"]})
    found["neighbors"] = {int(i): tuple(js) for i, js in found["neighbors"].items()}
    return found


def say(answer: dict[str, Any]) -> None:
    """One line to the bench."""
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


def wait_for_go() -> None:
    """Block until the bench says go; from then on, its end ends us."""
    if not sys.stdin.readline():
        os._exit(1)
    threading.Thread(
        target=lambda: os._exit(len(sys.stdin.read())), daemon=True
    ).start()


def report(rounds: dict[int, int], spec: dict[str, Any]) -> None:
    """In a thread: after `warm` s count the rounds and the CPU of `seconds` s, and say so."""
    thread = threading.Thread(target=_report, args=(rounds, spec), daemon=True)
    thread.start()


def _report(rounds: dict[int, int], spec: dict[str, Any]) -> None:
    time.sleep(spec["warm"])
    before = dict(rounds)
    cpu = time.process_time()
    began = time.perf_counter()
    time.sleep(spec["seconds"])
    after = dict(rounds)
    used = time.process_time() - cpu
    elapsed = time.perf_counter() - began
    done = {i: after[i] - before[i] for i in rounds}
    messages = sum(done[i] * len(spec["neighbors"][i]) for i in rounds)
    say(
        {
            "rounds_per_s": min(done.values()) / elapsed,
            "messages_per_s": messages / elapsed,
            "cores": used / elapsed,
        }
    )
