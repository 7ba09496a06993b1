"""On PYTHONPATH of a test's processes, beside tests/: a Crazyradio that is not there is number 0.

The folder FAKE_USB says which drones it reaches, in `drones`: {address: UDP port}, all on channel 80; while it holds a
file `pulled`, the dongle is not plugged in.
"""

import importlib.machinery
import json
import os
import sys
from pathlib import Path

MODULE, FOLDER = "cflib.drivers.crazyradio", os.environ.get("FAKE_USB", "")


class Finder:
    """Finds cflib's module of the dongle as Python does, and lets it see the fake."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        """Of MODULE only."""
        if name != MODULE:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        load = spec.loader.exec_module

        def loaded(module):
            load(module)
            module._find_devices = found

        spec.loader.exec_module = loaded
        return spec


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
    return [Dongle({(80, name): Receiver(port) for name, port in drones.items()})] if is_plugged() else []


if FOLDER:
    sys.meta_path.insert(0, Finder)
