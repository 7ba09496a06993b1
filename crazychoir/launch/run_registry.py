"""The runs on this machine: each leaves a record while it flies, so that other shells of its user find its swarm.

A record lies in the private folder of the user, which is the same in every environment of that user. Root finds the
runs of all users, as it may have to end them: its own first, then those of the user of `sudo`, then all others.
"""

import contextlib
import fcntl
import json
import logging
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import msgspec

from crazychoir.errors import ConfigError
from crazychoir.files.private_folder import existing_runtime_folder, runtime_folder
from crazychoir.files.user_folders import (
    RUNTIME_VARIABLE,
    SHARED_FOLDER,
    owner_fault,
    private_folder_of,
)

log = logging.getLogger(__name__)
LARGEST_RECORD = 1 << 16  # bytes


@dataclass(frozen=True)
class Run:
    """One `crazychoir run`.

    swarm: the name that its swarm flies under;  what: what was to be run;  source: the swarm file that was named,
    resolved, None without one;  file: the swarm file that it flies by, with its own name and ports.
    """

    swarm: str
    what: str
    source: str | None
    file: str


@contextlib.contextmanager
def recorded(run: Run) -> Iterator[None]:
    """Others find this run, until it ends however it ends: its record is locked, and a lock dies with its process.

    Where no record can be written it flies, with a warning. Raises ConfigError where the folder is another user's.
    """
    with contextlib.ExitStack() as kept:
        try:
            kept.enter_context(_record(run))
        except OSError as error:
            do = f"Other shells must name it: crazychoir land --swarm {run.file}"
            log.warning(
                "%s: %s: no record of this run. %s",
                error.filename or "record",
                error.strerror or error,
                do,
            )
        yield


@contextlib.contextmanager
def _record(run: Run) -> Iterator[None]:
    """The record of a run; raises OSError if it cannot be written."""
    folder = runtime_folder()
    path, hidden = (
        folder / f"{prefix}{run.swarm}-{os.getpid()}" for prefix in ("", ".")
    )
    with contextlib.ExitStack() as kept:
        for left in (path, hidden):
            kept.callback(_remove, left)
        file = kept.enter_context(hidden.open("w", encoding="utf-8"))
        fcntl.flock(file, fcntl.LOCK_EX)
        json.dump(asdict(run), file)
        file.flush()
        hidden.rename(path)  # seen by nobody before it is locked and whole
        yield


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


def runs() -> list[Run]:
    """Return the runs that a command without a swarm file may mean, in the order of names.

    Those of this user; for root, where there are none, those of the user of `sudo`; where there are none, all.
    Several runs of one swarm, each with some of its drones, count once.
    """
    for group in _runs_by_user():
        if group:
            return group
    return []


def every_run() -> list[Run]:
    """Return all runs that this user may see."""
    found = [run for group in _runs_by_user() for run in group]
    return list({run.swarm: run for run in found}.values())


def of_file(path: str | Path) -> list[Run]:
    """Those that fly that swarm file."""
    source = str(Path(path).resolve())
    return [run for run in every_run() if run.source == source]


def _runs_by_user() -> Iterator[list[Run]]:
    """The runs of this user, and for root those of the user of `sudo`, then those of all other users."""
    try:
        folder = existing_runtime_folder()
        yield _runs_in(folder, os.getuid()) if folder else []
    except (ConfigError, OSError) as error:
        _warn_once(
            f"runs of this user are not found: {error}. Or name the swarm: --swarm FILE"
        )
    if os.getuid() != 0 or RUNTIME_VARIABLE in os.environ:
        return
    caller = os.environ.get("SUDO_UID", "")
    if caller.isdecimal() and int(caller) != 0:
        yield _runs_of(int(caller))
    others = [
        path.name.rpartition("-")[2]
        for path in sorted(Path(SHARED_FOLDER).glob("crazychoir-*"))
    ]
    uids = [
        int(text) for text in others if text.isdecimal() and text not in ("0", caller)
    ]
    yield [run for uid in uids for run in _runs_of(uid)]


@cache
def _warn_once(text: str) -> None:
    """A command that waits for a swarm looks at the runs again and again."""
    log.warning("%s", text)


def _runs_of(uid: int) -> list[Run]:
    """The runs of another user; what lies there and is not of that user is left alone."""
    folder = private_folder_of(uid)
    try:
        return [] if owner_fault(folder, uid) else _runs_in(folder, uid)
    except OSError:
        return []


def _runs_in(folder: Path, uid: int) -> list[Run]:
    found = [run for path in sorted(folder.iterdir()) if (run := _read(path, uid))]
    return list({run.swarm: run for run in found}.values())


def _read(path: Path, uid: int) -> Run | None:
    """The run of a record, None if it has ended: then the record goes."""
    if path.name.startswith("."):
        return None
    try:
        with open(path, encoding="utf-8", opener=_open_file) as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode) or found.st_uid != uid:
                return None
            if _locked(file.fileno()):
                run = msgspec.json.decode(file.read(LARGEST_RECORD), type=Run)
                return run if _is_sound(run, uid) else None
            if uid == os.getuid():
                path.unlink()
    except (OSError, ValueError, RecursionError, msgspec.MsgspecError):
        pass
    return None


def _is_sound(run: Run, uid: int) -> bool:
    """Return whether a record says what a run of this user may say: plain names, and a regular swarm file."""
    if not re.fullmatch(r"[\w.-]+", run.swarm) or not run.what.isprintable():
        return False
    try:
        file = os.stat(run.file, follow_symlinks=False)
    except FileNotFoundError:
        return True
    return stat.S_ISREG(file.st_mode) and file.st_uid == uid


def _open_file(path: str, flags: int) -> int:
    """Open what may be another user's: no symbolic link is followed, and no pipe is waited for."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK)


def _locked(file: int) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    return False
