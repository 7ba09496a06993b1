"""The runs of this user on this machine: each leaves a record while it flies, so that others find its swarm."""

import contextlib
import fcntl
import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from crazychoir.runtime.places import runtime_folder


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
    """Others find this run, until it ends however it ends: its record is locked, and a lock dies with its process."""
    folder = runtime_folder()
    if folder is None:
        yield
        return
    path, hidden = (folder / f"{prefix}{run.swarm}-{os.getpid()}" for prefix in ("", "."))
    with hidden.open("w", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
            json.dump(asdict(run), file)
            file.flush()
            hidden.rename(path)  # seen by nobody before it is locked and whole
            yield
        finally:
            for left in (path, hidden):
                left.unlink(missing_ok=True)


def runs() -> list[Run]:
    """What runs now, in the order of names; several of one swarm, each with some of its drones, count once."""
    folder = runtime_folder()
    found = [run for path in sorted(folder.iterdir()) if (run := _read(path))] if folder else []
    return list({run.swarm: run for run in found}.values())


def of_file(path: str | Path) -> list[Run]:
    """Those that fly that swarm file."""
    source = str(Path(path).resolve())
    return [run for run in runs() if run.source == source]


def _read(path: Path) -> Run | None:
    """The run of a record, None if it has ended: then the record goes."""
    if path.name.startswith("."):
        return None
    try:
        with path.open(encoding="utf-8") as file:
            if _locked(file.fileno()):
                return Run(**json.load(file))
            path.unlink()
    except (OSError, ValueError, TypeError):
        pass
    return None


def _locked(file: int) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    return False
