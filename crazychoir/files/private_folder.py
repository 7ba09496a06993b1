"""Where processes of one user leave word for each other."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from crazychoir.errors import ConfigError
from crazychoir.files.user_folders import (
    RUNTIME_VARIABLE,
    make_private,
    owner_fault,
    private_folder,
    private_folder_of,
    write_fault,
)

ALLOWED = "a folder of this user alone"
REMOVE_IT = (
    f"Remove it, if need be as root; or set {RUNTIME_VARIABLE} to a folder of yours, "
    "alike in every shell and service."
)
"""What to do where another user, by mistake or on purpose, has taken the place."""
NAME_ANOTHER = (
    f"Let {RUNTIME_VARIABLE} name a folder of yours that others cannot use "
    "(mkdir -m 700 FOLDER), alike in every shell and service."
)
"""What to do where the folder was named, and must not be changed or removed."""


def _remedy(folder: Path) -> str:
    return REMOVE_IT if folder == private_folder_of(os.getuid()) else NAME_ANOTHER


def runtime_folder() -> Path:
    """Return the private folder of this user; it is made if it is missing.

    It is the same in a login shell, under cron, in a service and with `su`, so that each finds what others have left.
    Raises ConfigError where it belongs to another user or is a symbolic link, and OSError where it cannot be made.
    """
    folder = private_folder()
    fault = make_private(folder)
    if fault:
        raise ConfigError(str(folder), fault, ALLOWED, _remedy(folder))
    return folder


def existing_runtime_folder() -> Path | None:
    """Return the private folder of this user, None if there is none; raises as `runtime_folder` does."""
    folder = private_folder()
    try:
        fault = owner_fault(folder, os.getuid())
    except FileNotFoundError:
        return None
    if fault:
        raise ConfigError(str(folder), fault, ALLOWED, _remedy(folder))
    return folder


@contextlib.contextmanager
def scratch_folder(prefix: str) -> Iterator[Path]:
    """A temporary folder of this user alone, removed at the end; raises ConfigError where none can be made or is full.

    prefix: how its name begins.
    """
    try:
        made = tempfile.TemporaryDirectory(prefix=prefix)
    except OSError as error:
        raise _no_scratch(str(error)) from error
    with made as folder:
        fault = write_fault(Path(folder))
        if fault:
            raise _no_scratch(f"{Path(folder).parent}: {fault}")
        yield Path(folder)


def _no_scratch(found: str) -> ConfigError:
    do = "Free some room, or set TMPDIR to another folder."
    return ConfigError(
        "temporary folder", found, "a folder that can be written and has room", do
    )
