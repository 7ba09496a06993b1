"""The cache of tables of contents (log variables, parameters): on disk, by checksum.

All links share it.
"""

import contextlib
import hashlib
import json
import logging
import os
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cflib.crazyflie.log import LogTocElement
from cflib.crazyflie.param import ParamTocElement

from crazychoir.files.user_folders import CACHE_WARNING, cache_home

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class TableWait:
    """How a link waits for the table that another link loads."""

    longest: float = 60.0
    """s: time for which a link waits while another link loads the table. This is longer than a
    link may take to open.
    """
    check_period: float = 0.25
    """s: time between two checks whether that link, or this one, was closed meanwhile."""


TABLE_WAIT = TableWait()


ENTRY_FIELDS = ("ident", "group", "name", "ctype", "pytype", "access")
"""Fields of a table entry that are kept."""
ENTRY_CLASSES = {"log": LogTocElement, "param": ParamTocElement}
"""cflib's class of the entries of each kind of table."""

TABLE_CACHE_NAME = "tables of contents"
"""Name of this cache in warnings."""

Contents = dict[str, dict[str, Any]]
"""Entries of a table by group and name."""


class TableOfContents:
    """A cache of tables of contents with cflib's interface: `fetch` and `insert`, from any thread.

    Drones with the same firmware have the same tables, so the first link loads them and the others
    wait. A file is written as a whole or not at all, even if several processes write at the same
    time.

    folder: folder of the files; None: tables are kept in this process only
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self._damaged: list[int] = []
        self._warned = False
        self._known: dict[int, Contents] = {}
        self._asked: dict[int, int] = {}
        self._closed: dict[int, None] = {}
        self._told = threading.Condition()

    def fetch(self, crc: int) -> Contents | None:
        """Return the table with this checksum, from memory or disk.

        If another link is loading this table, wait for it, at most TABLE_WAIT.longest s.
        Returns None if the caller must load the table from its drone.

        crc: checksum of the table, from its drone
        """
        me = threading.get_ident()
        with self._told:
            self._closed.pop(me, None)
            for _ in range(round(TABLE_WAIT.longest / TABLE_WAIT.check_period)):
                found = self._known.get(crc) or self._read(crc)
                if found is not None:
                    self._known[crc] = found
                    return found
                if self._asked.setdefault(crc, me) == me or me in self._closed:
                    return None
                self._told.wait(TABLE_WAIT.check_period)
        return None

    def insert(self, crc: int, contents: Contents) -> None:
        """Keep a table that a drone has sent."""
        with self._told:
            self._known[crc] = contents
            self._asked.pop(crc, None)
            self._told.notify_all()
        if self.folder is None:
            self._warn("no home folder")
            return
        try:
            self._write(self.folder, crc, contents)
        except OSError as error:
            self._warn(f"{self.folder}: {error.strerror or error}")

    def _warn(self, fault: str) -> None:
        """Log once why nothing is kept on disk."""
        if not self._warned:
            self._warned = True
            do = "Set XDG_CACHE_HOME to a folder that can be written and has room."
            log.warning(
                "%s%s: %s: they are not stored, so connecting takes longer. %s",
                CACHE_WARNING,
                TABLE_CACHE_NAME,
                fault,
                do,
            )

    def forget(self, thread: int) -> None:
        """Note that the link of this thread is closed, so that others no longer wait for its tables."""
        with self._told:
            self._asked = {
                crc: asker for crc, asker in self._asked.items() if asker != thread
            }
            self._closed[thread] = None
            self._told.notify_all()

    def _read(self, crc: int) -> Contents | None:
        if self.folder is None or crc in self._damaged:
            return None
        file = _table_file(self.folder, crc)
        try:
            return decode_table(file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (
            OSError,
            ValueError,
            KeyError,
            TypeError,
            AttributeError,
            RecursionError,
        ) as error:
            self._damaged.append(crc)  # so that waiting links do not read it again
            log.warning("%s: %s: requested from the drone again", file, error)
            return None

    def _write(self, folder: Path, crc: int, contents: Contents) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=folder, prefix=".")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(encode_table(contents))
            os.replace(name, _table_file(folder, crc))
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise


def _table_file(folder: Path, crc: int) -> Path:
    return folder / f"{crc:08X}.json"


def _table_digest(kind: str, elements: list[Any]) -> str:
    """Return the digest of a table, which reveals a damaged file that is still valid JSON."""
    return hashlib.blake2b(
        json.dumps([kind, elements]).encode(), digest_size=8
    ).hexdigest()


def encode_table(contents: Contents) -> str:
    """Return a table as text."""
    elements = [element for group in contents.values() for element in group.values()]
    kind = (
        "param"
        if any(isinstance(element, ParamTocElement) for element in elements)
        else "log"
    )
    values = [[getattr(element, f) for f in ENTRY_FIELDS] for element in elements]
    return json.dumps(
        {"kind": kind, "check": _table_digest(kind, values), "elements": values}
    )


def decode_table(text: str) -> Contents:
    """Return the table of a text.

    cflib would ask at every connection whether a parameter is persistent; this is not kept.
    Raises ValueError, KeyError, TypeError or AttributeError if the text is not valid.
    """
    raw = json.loads(text)
    kind = ENTRY_CLASSES[raw["kind"]]
    found = Contents()
    if raw["check"] != _table_digest(raw["kind"], raw["elements"]):
        raise ValueError("it is damaged: its digest does not match")
    for values in raw["elements"]:
        element = kind()
        for name, value in zip(ENTRY_FIELDS, values, strict=True):
            setattr(element, name, value)
        found.setdefault(element.group, {})[element.name] = element
    return found


def tables_folder() -> Path | None:
    """Return this user's folder for tables; None if there is no place for caches."""
    own = cache_home()
    return None if own is None else own / "crazychoir" / "contents"
