"""What drones have told of their log variables and parameters, by checksum: kept on disk, shared by all links."""

import contextlib
import json
import logging
import os
import tempfile
import threading
from pathlib import Path
from typing import Any

from cflib.crazyflie.log import LogTocElement
from cflib.crazyflie.param import ParamTocElement

log = logging.getLogger(__name__)
PATIENCE, LOOKS = 60.0, 0.25
"""s that a link waits for what another one is being told, longer than each is given to open; and after which it looks
whether that one, or itself, has been closed meanwhile."""
FIELDS = ("ident", "group", "name", "ctype", "pytype", "access")
KINDS = {"log": LogTocElement, "param": ParamTocElement}

Contents = dict[str, dict[str, Any]]


class TableOfContents:
    """A cache of tables of contents, in the shape that cflib wants one: `fetch` and `insert`, from any thread.

    Drones with the same firmware have the same tables, so the first link asks and the others wait for its answer. A
    file is there whole or not at all, whoever writes at the same time.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[int, Contents] = {}
        self._asked: dict[int, int] = {}
        self._closed: dict[int, None] = {}
        self._told = threading.Condition()

    def fetch(self, crc: int) -> Contents | None:
        """The table with this checksum; None: whoever asks is to get it from its drone."""
        me = threading.get_ident()
        with self._told:
            self._closed.pop(me, None)
            for _ in range(round(PATIENCE / LOOKS)):
                found = self._known.get(crc) or self._read(crc)
                if found is not None:
                    self._known[crc] = found
                    return found
                if self._asked.setdefault(crc, me) == me or me in self._closed:
                    return None
                self._told.wait(LOOKS)
        return None

    def insert(self, crc: int, contents: Contents) -> None:
        """A drone has told its table."""
        with self._told:
            self._known[crc] = contents
            self._asked.pop(crc, None)
            self._told.notify_all()
        try:
            self._write(crc, contents)
        except OSError as error:
            log.warning("%s: %s: tables of contents are not kept; connecting takes longer", self.folder, error.strerror)

    def forget(self, thread: int) -> None:
        """The link of this thread is closed: who waits for what it was being told asks itself."""
        with self._told:
            self._asked = {crc: who for crc, who in self._asked.items() if who != thread}
            self._closed[thread] = None
            self._told.notify_all()

    def _file(self, crc: int) -> Path:
        return self.folder / f"{crc:08X}.json"

    def _read(self, crc: int) -> Contents | None:
        try:
            return decoded(self._file(crc).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            log.warning("%s: %s: asked of the drone again", self._file(crc), error)
            return None

    def _write(self, crc: int, contents: Contents) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=self.folder, prefix=".")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(encoded(contents))
            os.replace(name, self._file(crc))
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise


def encoded(contents: Contents) -> str:
    """As text."""
    elements = [element for group in contents.values() for element in group.values()]
    kind = "param" if any(isinstance(element, ParamTocElement) for element in elements) else "log"
    return json.dumps({"kind": kind, "elements": [[getattr(element, f) for f in FIELDS] for element in elements]})


def decoded(text: str) -> Contents:
    """From text; ValueError, KeyError, TypeError or AttributeError for another one.

    Whether a parameter is persistent is not kept: cflib would ask for each at every connection.
    """
    raw = json.loads(text)
    kind, found = KINDS[raw["kind"]], Contents()
    for values in raw["elements"]:
        element = kind()
        for name, value in zip(FIELDS, values, strict=True):
            setattr(element, name, value)
        found.setdefault(element.group, {})[element.name] = element
    return found


def folder() -> Path:
    """Where this user keeps them."""
    kept = os.environ.get("XDG_CACHE_HOME")
    return (Path(kept) if kept else Path.home() / ".cache") / "crazychoir" / "contents"
