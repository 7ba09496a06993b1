"""A process that flies the runs of a sweep, one after the other: it imports and loads laws once.

It reads a run as a line of JSON from standard input, and writes its row as a line of JSON to standard
output, until the input ends.
"""

import ctypes
import os
import signal

from crazychoir.numerics.compiling import KERNEL_QUEUE

PR_SET_PDEATHSIG = 1
"""Option of prctl(2): a signal at the end of the parent."""


def main() -> None:
    """Run the process. What a mission prints goes to standard error."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)
        with KERNEL_QUEUE.checks_first():
            from crazychoir.api.sweep_flights import fly_runs_of_input
        KERNEL_QUEUE.load_kept()
        fly_runs_of_input(answers)


if __name__ == "__main__":
    main()
