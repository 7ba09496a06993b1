"""Who has a dongle: one process of this user and machine at a time, found by a lock that dies with it."""

import contextlib
import fcntl
import os
from collections.abc import Iterable, Iterator
from typing import IO

from crazychoir.errors import Refused
from crazychoir.runtime.places import runtime_folder
from crazychoir.swarm.config import SwarmConfig

LAND_FIRST = "and may fly drones: land them first (Ctrl-C there, or `crazychoir land`)"


@contextlib.contextmanager
def owned(config: SwarmConfig, dongle: int) -> Iterator[None]:
    """This process owns a dongle, or, of virtual drones, their addresses; Refused while another one does."""
    with contextlib.ExitStack() as kept:
        for name in _names(config, dongle):
            kept.enter_context(_locked(name, dongle, f"{os.getpid()} (swarm {config.name})"))
        yield


def require_free(config: SwarmConfig, dongles: Iterable[int]) -> None:
    """Refused while another process owns one of these dongles, before anything is started that needs it."""
    for dongle in dongles:
        for name in _names(config, dongle):
            with _locked(name, dongle, None):
                pass


def _names(config: SwarmConfig, dongle: int) -> list[str]:
    """Of its locks, in an order that all keep to."""
    uris = [config.drone(i).uri for i in config.dongles[dongle]]
    names = {f"dongle-{uri.split('/')[2]}" if uri.startswith("radio") else uri for uri in uris}
    return [name.replace("/", "_").replace(":", "_") for name in sorted(names)]


@contextlib.contextmanager
def _locked(name: str, dongle: int, who: str | None) -> Iterator[None]:
    """Nobody else has it; who: what others are told of its owner, None: it is only looked at."""
    folder = runtime_folder()
    if folder is None:
        yield
        return
    file: IO[str] = (folder / f".{name}.lock").open("a+", encoding="utf-8")
    try:
        fcntl.flock(file, (fcntl.LOCK_SH if who is None else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        found = f"process {file.read().strip() or '?'} has it"
        raise Refused(f"dongle {dongle}", f"{found}, {LAND_FIRST}") from None
    else:
        if who is not None:
            file.truncate(0)
            file.write(who)
            file.flush()
        yield
    finally:
        file.close()
