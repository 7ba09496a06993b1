"""On PYTHONPATH of a test's processes, beside tests/: a link to a drone can be opened once at a time, as a dongle.

Each opening of a uri takes a lock in the folder EXCLUSIVE_LINKS, and adds a line to `opened` there; another one raises.
"""

import fcntl
import os
from pathlib import Path

from when_loaded import when_loaded

FOLDER = os.environ.get("EXCLUSIVE_LINKS", "")


def make_exclusive(drivers):
    """Let `connect` of the driver take the lock of its uri, and `close` give it back."""
    driver = drivers.LossyUdpDriver
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
    when_loaded("crazychoir.radio.link.drivers", make_exclusive)
