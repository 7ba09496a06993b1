"""How a command's process ends, and with whom."""

import ctypes
import os
import signal
import sys
from collections.abc import Callable

from crazychoir.runtime.outputs import let_outputs_take_any_text

_PR_SET_PDEATHSIG = 1


def with_parent() -> None:
    """A process that another one has started lands or ends by SIGHUP when that one is gone.

    Ctrl-C comes to it through its parent; before there is anything to land it ends at once, and says nothing.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGHUP)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def run(app: Callable[[], None]) -> None:
    """Run a command and end with its exit code, at once.

    Who has had a Zenoh session has its threads, and maybe one that does not close: while the interpreter is being taken
    down they may hang it, or abort the process, after its result is written and with another exit code.
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
