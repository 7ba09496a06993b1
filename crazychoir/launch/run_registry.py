"""The registry of runs on this machine: other shells of the same user find a running swarm in it.

Each run leaves a record in the private folder of the user while it flies. The folder is the
same in every environment of that user. Root finds the runs of all users, because root may have
to end them: first its own, then those of the user of `sudo`, then all others.
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
"""Largest size of a record, bytes."""


@dataclass(frozen=True)
class RunRecord:
    """One `crazychoir run`."""

    swarm: str
    """Name that the swarm flies under."""
    what: str
    """Mission or file given to the command."""
    source: str | None
    """Resolved path of the swarm file that was named, None without one."""
    file: str
    """Swarm file of this flight, with its own name and ports."""


@contextlib.contextmanager
def record_run(run: RunRecord) -> Iterator[None]:
    """Keep a record of this run until it ends, so that other shells find it.

    The record is locked. The lock ends with the process, even if the process crashes.
    If no record can be written, the run flies with a warning.
    Raises ConfigError if the folder belongs to another user.
    """
    with contextlib.ExitStack() as kept:
        try:
            kept.enter_context(_write_record(run))
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
def _write_record(run: RunRecord) -> Iterator[None]:
    """Write and lock the record of a run, and delete it at the end.

    Raises OSError if it cannot be written.
    """
    folder = runtime_folder()
    path, hidden = (
        folder / f"{prefix}{run.swarm}-{os.getpid()}" for prefix in ("", ".")
    )
    with contextlib.ExitStack() as kept:
        for left in (path, hidden):
            kept.callback(_delete_record, left)
        file = kept.enter_context(hidden.open("w", encoding="utf-8"))
        fcntl.flock(file, fcntl.LOCK_EX)
        json.dump(asdict(run), file)
        file.flush()
        hidden.rename(path)  # visible only when it is locked and complete
        yield


def _delete_record(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


def list_own_runs() -> list[RunRecord]:
    """Return the runs that a command without a swarm file may mean, in the order of names.

    These are the runs of this user. If root has none, they are those of the user of `sudo`, and
    if there are none either, all runs.
    Several runs of one swarm, each with some of its drones, count once.
    """
    for group in _list_runs_by_user():
        if group:
            return group
    return []


def list_every_run() -> list[RunRecord]:
    """Return all runs that this user may see."""
    found = [run for group in _list_runs_by_user() for run in group]
    return list({run.swarm: run for run in found}.values())


def list_runs_of_file(path: str | Path) -> list[RunRecord]:
    """Return the runs that fly this swarm file."""
    source = str(Path(path).resolve())
    return [run for run in list_every_run() if run.source == source]


def _list_runs_by_user() -> Iterator[list[RunRecord]]:
    """Yield the runs of this user; for root also those of the user of `sudo`, then all others."""
    try:
        folder = existing_runtime_folder()
        yield _list_runs_in(folder, os.getuid()) if folder else []
    except (ConfigError, OSError) as error:
        _warn_once(
            f"runs of this user are not found: {error}. Or name the swarm: --swarm FILE"
        )
    if os.getuid() != 0 or RUNTIME_VARIABLE in os.environ:
        return
    caller = os.environ.get("SUDO_UID", "")
    if caller.isdecimal() and int(caller) != 0:
        yield _list_runs_of(int(caller))
    others = [
        path.name.rpartition("-")[2]
        for path in sorted(Path(SHARED_FOLDER).glob("crazychoir-*"))
    ]
    uids = [
        int(text) for text in others if text.isdecimal() and text not in ("0", caller)
    ]
    yield [run for uid in uids for run in _list_runs_of(uid)]


@cache
def _warn_once(text: str) -> None:
    """Log a warning once: a command that waits for a swarm reads the registry many times."""
    log.warning("%s", text)


def _list_runs_of(uid: int) -> list[RunRecord]:
    """Return the runs of another user.

    A folder or record that does not belong to that user is ignored.
    """
    folder = private_folder_of(uid)
    try:
        return [] if owner_fault(folder, uid) else _list_runs_in(folder, uid)
    except OSError:
        return []


def _list_runs_in(folder: Path, uid: int) -> list[RunRecord]:
    found = [
        run for path in sorted(folder.iterdir()) if (run := _read_record(path, uid))
    ]
    return list({run.swarm: run for run in found}.values())


def _read_record(path: Path, uid: int) -> RunRecord | None:
    """Return the run of a record; None if it has ended, and then delete the record."""
    if path.name.startswith("."):
        return None
    try:
        with open(path, encoding="utf-8", opener=_open_file) as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode) or found.st_uid != uid:
                return None
            if _is_locked(file.fileno()):
                # json, not msgspec: file names that are not UTF-8 are written as surrogates.
                said = json.loads(file.read(LARGEST_RECORD))
                said["what"] = _make_printable(str(said["what"]))
                run = msgspec.convert(said, RunRecord)
                return run if _is_sound(run, uid) else None
            if uid == os.getuid():
                path.unlink()
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        RecursionError,
        msgspec.MsgspecError,
    ):
        pass
    return None


def _make_printable(text: str) -> str:
    """Return the text with a question mark for each character that a terminal could obey or not show."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _is_sound(run: RunRecord, uid: int) -> bool:
    """Return whether a record is plausible: a plain name, and a regular swarm file of the user."""
    if not re.fullmatch(r"[\w.-]+", run.swarm):
        return False
    try:
        file = os.stat(run.file, follow_symlinks=False)
    except FileNotFoundError:
        return True
    return stat.S_ISREG(file.st_mode) and file.st_uid == uid


def _open_file(path: str, flags: int) -> int:
    """Open a file of any user: follow no symbolic link, and do not wait for a pipe."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK)


def _is_locked(file: int) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    return False
