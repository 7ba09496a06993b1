"""How the process of a command ends."""

import ctypes
import os
import signal
import sys
from collections.abc import Callable

from crazychoir.runtime.outputs import let_outputs_take_any_text

_PR_SET_PDEATHSIG = 1
"""Option of prctl(2): the signal that this process gets when its parent ends."""


def end_after_parent() -> None:
    """Let this process land or end by SIGHUP when its parent process has ended.

    Ctrl-C comes through the parent. Before there is anything to land, it ends this process at once
    and without a message.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGHUP)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def run_to_exit(app: Callable[[], None]) -> None:
    """Run a command and end at once with its exit code.

    A process that has had a Zenoh session has threads of Zenoh, and one of them may not close.
    While the interpreter shuts down they may hang the process. They may also abort it with
    another exit code after its result is written.
    """
    let_outputs_take_any_text()
    try:
        app()
    except SystemExit as ended:
        if (
            isinstance(ended.code, int)
            and "crazychoir.bus.network.zenoh_link" in sys.modules
        ):
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(ended.code)
        raise
