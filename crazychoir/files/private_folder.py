"""The private folder, in which processes of one user leave files for each other."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class FolderTexts:
    """Texts of errors about the private folder: what is allowed, and what to do."""

    allowed: str = "a folder of this user alone"
    """The allowed folder, for errors."""
    remove_it: str = (
        f"Remove it, if need be as root; or set {RUNTIME_VARIABLE} to a folder of yours, "
        "alike in every shell and service."
    )
    """Advice if another user has taken the place, by mistake or on purpose."""
    name_another: str = (
        f"Let {RUNTIME_VARIABLE} name a folder of yours that others cannot use "
        "(mkdir -m 700 FOLDER), alike in every shell and service."
    )
    """What to do where the folder was named, and must not be changed or removed."""


FOLDER_TEXTS = FolderTexts()


def _remedy(folder: Path) -> str:
    return (
        FOLDER_TEXTS.remove_it
        if folder == private_folder_of(os.getuid())
        else FOLDER_TEXTS.name_another
    )


def runtime_folder() -> Path:
    """Return the private folder of this user; make it if it is missing.

    It is the same in a login shell, under cron, in a service and with `su`, so that each finds the
    files of the others.
    Raises ConfigError if it belongs to another user or is a symbolic link.
    Raises OSError if it cannot be made.
    """
    folder = private_folder()
    fault = make_private(folder)
    if fault:
        raise ConfigError(str(folder), fault, FOLDER_TEXTS.allowed, _remedy(folder))
    return folder


def existing_runtime_folder() -> Path | None:
    """Return the private folder of this user, or None if there is none.

    Raises the errors of `runtime_folder`.
    """
    folder = private_folder()
    try:
        fault = owner_fault(folder, os.getuid())
    except FileNotFoundError:
        return None
    if fault:
        raise ConfigError(str(folder), fault, FOLDER_TEXTS.allowed, _remedy(folder))
    return folder


@contextlib.contextmanager
def scratch_folder(prefix: str) -> Iterator[Path]:
    """Yield a temporary folder that only this user can read; remove it at the end.

    prefix: start of its name
    Raises ConfigError if no folder can be made or the disk is full.
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
