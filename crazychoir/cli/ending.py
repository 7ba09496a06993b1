"""How a command's process ends, and with whom."""

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable

_PR_SET_PDEATHSIG = 1


def with_parent() -> None:
    """A process that another one has started lands or ends by SIGHUP when that one is gone.

    Ctrl-C comes to it through its parent; before there is anything to land it ends at once, and says nothing.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGHUP)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def run(app: Callable[[], None]) -> None:
    """Run a command and end with its exit code, at once.

    A session that does not close is left behind in a thread. Were its call to come back while the interpreter is being
    taken down, the process would be aborted, after its result is written and with another exit code.
    """
    try:
        app()
    except SystemExit as ended:
        if isinstance(ended.code, int) and _left_behind():
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(ended.code)
        raise


def _left_behind() -> bool:
    if "crazychoir.bus.zenoh" not in sys.modules:
        return False
    from crazychoir.bus.zenoh import CLOSING

    return any(thread.name == CLOSING for thread in threading.enumerate())
