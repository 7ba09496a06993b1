"""Programs run as another user, or on a full disk: only root can start them, and elsewhere such tests are skipped."""

import contextlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

UNKNOWN_USER = 12345
"""A user id that the system does not know, as in a container with `--user`."""
NEEDED = "needs Linux, root, and setpriv and unshare of util-linux"
HOMELESS = (
    "HOME",
    "XDG_CACHE_HOME",
    "XDG_CONFIG_HOME",
    "XDG_RUNTIME_DIR",
    "NUMBA_CACHE_DIR",
    "MPLCONFIGDIR",
)
"""Variables that a service without a home does not have."""


def as_user(uid: int = UNKNOWN_USER) -> list[str]:
    """Return what a command line begins with to run as that user; the test is skipped where that cannot be.

    The user may read what others may not, as the interpreter may lie in the home of root, and writes only its own.
    """
    may_read = ["--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search"]
    words = ["setpriv", f"--reuid={uid}", f"--regid={uid}", "--clear-groups", *may_read]
    require(*words)
    return words


def in_own_namespace(*options: str) -> list[str]:
    """Return what a command line begins with to run in namespaces of its own, as unshare's options say."""
    words = ["unshare", *options]
    require(*words)
    return words


@cache
def can_run(*words: str) -> bool:
    if os.getuid() != 0 or shutil.which(words[0]) is None:
        return False
    return (
        subprocess.run([*words, "true"], capture_output=True, check=False).returncode
        == 0
    )


def require(*words: str) -> None:
    if not can_run(*words):
        pytest.skip(NEEDED)


def homeless(**changes: str) -> dict[str, str]:
    """Return this environment without the variables that name folders of a user, and with changes."""
    return {
        name: value for name, value in os.environ.items() if name not in HOMELESS
    } | changes


@contextlib.contextmanager
def open_folder() -> Iterator[Path]:
    """A folder in which every user may write; those of pytest are for their user alone."""
    with tempfile.TemporaryDirectory() as name:
        os.chmod(name, 0o777)  # noqa: S103 - that is what it is for
        yield Path(name)
