"""How the process of a command prints any text, and how it ends."""

import codecs
import ctypes
import os
import signal
import sys
from collections.abc import Callable
from io import TextIOWrapper

_PR_SET_PDEATHSIG = 1
"""Option of prctl(2): the signal that this process gets when its parent ends."""
OUTPUT_ERRORS = "crazychoir.output"
"""Name of the error handler of standard output and standard error."""


def end_after_parent() -> None:
    """Let this process land or end by SIGHUP when its parent process has ended.

    Ctrl-C comes through the parent. Before there is anything to land, it ends this process at once
    and without a message. A program that was started with nohup ignores SIGHUP; this process does not.
    """
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
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
            and "crazychoir.bus.network.zenoh_session" in sys.modules
        ):
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(ended.code)
        raise


def let_outputs_take_any_text() -> None:
    r"""Print characters that the encoding of the output lacks as escapes: \xfc or \u2192.

    This holds for standard output and standard error. Bytes of file names that are no characters
    are printed unchanged.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors=OUTPUT_ERRORS)


def _replace_character(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    characters = error.object[error.start : error.end]
    return b"".join(_output_bytes(character) for character in characters), error.end


def _output_bytes(character: str) -> bytes:
    """Return the byte that a lone surrogate stands for; for another character return an escape."""
    try:
        return character.encode("ascii", "surrogateescape")
    except UnicodeEncodeError:
        return character.encode("ascii", "backslashreplace")


codecs.register_error(OUTPUT_ERRORS, _replace_character)
