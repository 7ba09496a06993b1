"""What the commands that run one process of a swarm have in common."""

import os
from collections.abc import Callable
from typing import Any, Final, NoReturn

import typer

from crazychoir.errors import CrazyChoirError
from crazychoir.launch.console import (
    ERROR_CONSOLE,
    exit_with_error,
    set_up_logging,
    write_json,
)
from crazychoir.launch.process import ending

BLAS_LIBRARIES: Final = ("OPENBLAS", "MKL", "OMP")
"""Libraries that multiply matrices with as many threads as the machine has processors."""


def limit_matrix_threads(may_have_more: bool = True) -> None:
    """Let this process compute matrices without further threads.

    Call it before numpy is imported. The matrices of a drone are small.
    may_have_more: whether the environment may ask for more threads
    """
    for library in BLAS_LIBRARIES:
        name = f"{library}_NUM_THREADS"
        if name not in os.environ or not may_have_more:
            os.environ[name] = "1"


def begin_process(is_child: bool) -> None:
    """Set up the process of a command, before numpy is imported.

    is_child: whether it ends when its parent process has ended
    """
    limit_matrix_threads()
    if is_child:
        ending.end_after_parent()
    set_up_logging()


def announce_process(text: str, as_json: bool, is_child: bool) -> None:
    """Print what the process does, unless only its parent or a program reads it."""
    if not as_json and not is_child:
        ERROR_CONSOLE.print(text, highlight=False)


def run_to_report(run: Callable[[], dict[str, Any]], as_json: bool) -> NoReturn:
    """Run a process, print its report if JSON is asked for, and exit with its success."""
    try:
        report = run()
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    if as_json:
        write_json(report)
    raise typer.Exit(0 if report["success"] else 1)
