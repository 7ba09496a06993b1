"""On PYTHONPATH of a test's processes: a link to a drone can be opened once at a time, as a dongle.

Each opening of a uri takes a lock in the folder EXCLUSIVE_LINKS, and adds a line to `opened` there; another one raises.
"""

import fcntl
import importlib.machinery
import os
import sys
from pathlib import Path

MODULE, FOLDER = "crazychoir.radio.drivers", os.environ.get("EXCLUSIVE_LINKS", "")


class Finder:
    """Finds the module of the drivers as Python does, and changes what it has loaded."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        """Of MODULE only."""
        if name != MODULE:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        load = spec.loader.exec_module

        def loaded(module):
            load(module)
            make_exclusive(module.LossyUdpDriver)

        spec.loader.exec_module = loaded
        return spec


def make_exclusive(driver):
    """Let its `connect` take the lock of its uri, and its `close` give it back."""
    connect, close = driver.connect, driver.close

    def exclusive_connect(self, uri, *callbacks):
        self.lock = (Path(FOLDER) / uri.replace("/", "_")).open("w")
        with (Path(FOLDER) / "opened").open("a") as file:
            file.write(f"{os.getpid()} {uri}\n")
        try:
            fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RuntimeError(f"{uri} is open already") from None
        connect(self, uri, *callbacks)

    def exclusive_close(self):
        close(self)
        self.lock.close()

    driver.connect, driver.close = exclusive_connect, exclusive_close


if FOLDER:
    sys.meta_path.insert(0, Finder)
