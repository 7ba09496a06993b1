"""Write result files.

The place is checked before the computation, and a file is written as a whole or not at all.
"""

import contextlib
import errno
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crazychoir.errors import ConfigError


@dataclass(frozen=True, slots=True)
class OutputFileRules:
    """How an output file is tried out and replaced."""

    replacing_errors: tuple[int, ...] = (errno.EBUSY, errno.EPERM, errno.EACCES)
    """Errors of a file that can be written, but not replaced."""
    longest_suffix: int = 64
    """Characters of a suffix that a temporary name keeps."""
    probe: bytes = b"\0" * 4096
    """Bytes written into a new file and removed again.

    A full disk still creates files, but cannot fill them.
    """


OUTPUT_FILE_RULES = OutputFileRules()


def require_writable_file(
    path: str | Path, option: str, endings: Sequence[str] = (), parents: bool = False
) -> None:
    """Raise ConfigError, before anything is computed, if the file cannot be written.

    A missing folder is made. An existing file may be overwritten.

    option: name for errors
    endings: allowed suffixes of the name, in lower or upper case; empty: all
    parents: whether missing folders above the folder are made too
    """
    path = Path(path)
    if endings and path.suffix.lower() not in endings:
        raise ConfigError(
            option, str(path), f"a name that ends in {', '.join(endings)}"
        )
    if os.path.isdir(path):
        raise ConfigError(
            option,
            f"{path}, a folder",
            "the name of a file",
            f"Add a name to it: {path / 'NAME'}.",
        )
    try:
        _make_folder(path.parent, parents)
        place = Path(os.path.realpath(path))
        if place.exists():
            _open_to_write(place)
        else:
            _probe(place)
    except (OSError, ValueError) as error:
        raise _write_error(
            option,
            path,
            error,
            "a name in a folder that is there or can be made in one",
        ) from error


def require_writable_folder(path: str | Path, option: str) -> None:
    """Make the folder if it is missing; raise ConfigError if files cannot be written into it.

    Call it before anything is computed.

    option: name for errors
    """
    path = Path(path)
    try:
        _make_folder(path, parents=True)
        _probe(path / "probe")
    except (OSError, ValueError) as error:
        raise _write_error(
            option,
            path,
            error,
            "a folder that is there or can be made, and written into",
        ) from error


@contextlib.contextmanager
def output_file(path: str | Path, what: str) -> Iterator[Path]:
    """Yield the path to write to.

    If the block ends without an error, the file is moved to its place. So a full disk destroys no
    existing file and leaves no half-written file. A symbolic link is followed. A device is written
    directly, and so is an existing file in a folder where no new file can be made. The yielded path
    has the suffix of `path`, except for a device.

    what: name for errors
    Raises ConfigError in place of an OSError.
    """
    path = Path(path)
    place = Path(os.path.realpath(path))
    beside: Path | None = None
    direct = place.exists() and (
        not place.is_file() or not os.access(place.parent, os.W_OK)
    )
    try:
        if place.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(place))
        if direct:
            yield place
            return
        if place.exists():
            _open_to_write(place)  # keeps a write-protected file
        beside = _new_file_beside(place)
        yield beside
        if place.exists():
            shutil.copymode(place, beside)
        _put_in_place(beside, place)
    except OSError as error:
        raise _write_error(what, path, error, "a file that can be written") from error
    finally:
        if beside is not None:
            with contextlib.suppress(OSError):
                beside.unlink(missing_ok=True)


def _new_file_beside(place: Path) -> Path:
    """Make an empty file in the folder of `place` under a name that was free, with the usual permissions."""
    suffix = (
        place.suffix if len(place.suffix) <= OUTPUT_FILE_RULES.longest_suffix else ""
    )
    while True:
        new = place.with_name(f".{secrets.token_hex(8)}{suffix}")
        try:
            os.close(os.open(new, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        except FileExistsError:
            continue
        return new


def _put_in_place(new: Path, place: Path) -> None:
    """Give a new file its place; where the place cannot be replaced, write the content into it.

    A file that is mounted by itself, and another user's file in a sticky folder, can be written but not replaced.
    """
    try:
        new.replace(place)
    except OSError as error:
        if error.errno not in OUTPUT_FILE_RULES.replacing_errors or not place.exists():
            raise
        shutil.copyfile(new, place)


def save_figure(figure: Any, path: str | Path, **options: Any) -> None:
    """Write a figure of matplotlib, in the format of the suffix.

    Raises ConfigError if it cannot be written.
    """
    kind = Path(path).suffix.removeprefix(".").lower() or None
    with output_file(path, "picture") as place:
        figure.savefig(place, format=kind, **options)


def _make_folder(folder: Path, parents: bool) -> None:
    if not folder.is_dir():
        folder.mkdir(parents=parents, exist_ok=True)


def _open_to_write(path: Path) -> None:
    """Open an existing file for writing, without changing it.

    Raises OSError if it cannot be opened.
    """
    os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC))


def _probe(path: Path) -> None:
    """Create and fill a file beside `path`, then remove it. Raises OSError if there is no room.

    The name itself is looked up, because it may be too long.
    """
    with contextlib.suppress(FileNotFoundError):
        path.lstat()
    with tempfile.TemporaryFile(dir=path.parent, buffering=0) as file:
        if file.write(OUTPUT_FILE_RULES.probe) < len(OUTPUT_FILE_RULES.probe):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def _write_error(
    option: str, path: Path, error: Exception, allowed: str
) -> ConfigError:
    why = getattr(error, "strerror", None) or str(error)
    named = getattr(error, "filename", None)
    there = (
        f"{named}: " if isinstance(named, str) and Path(named) == path.parent else ""
    )
    return ConfigError(option, str(path), allowed, f"{there}{why}.")
