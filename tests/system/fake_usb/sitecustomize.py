"""On PYTHONPATH of a test's processes, beside tests/: a Crazyradio that is not there is number 0.

The folder FAKE_USB says which drones it reaches, in `drones`: {address: UDP port}, all on channel 80; while it holds a
file `pulled`, the dongle is not plugged in.
"""

import json
import os
from pathlib import Path

from when_loaded import when_loaded

FOLDER = os.environ.get("FAKE_USB", "")


def plug_in(crazyradio):
    """Let cflib's module of the dongle see the fake."""
    crazyradio._find_devices = found


def is_plugged():
    """Whether the dongle is."""
    return not (Path(FOLDER) / "pulled").exists()


def found(serial=None):
    """The dongles that are plugged in."""
    from fake_dongle import FakeDongle, Receiver

    class Dongle(FakeDongle):
        """Looks before each use whether it still is."""

        def _require(self):
            self.there = is_plugged()
            super()._require()

    drones = json.loads((Path(FOLDER) / "drones").read_text())
    return (
        [Dongle({(80, name): Receiver(port) for name, port in drones.items()})]
        if is_plugged()
        else []
    )


if FOLDER:
    when_loaded("cflib.drivers.crazyradio", plug_in)
