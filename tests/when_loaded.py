"""For a sitecustomize.py on PYTHONPATH of a test's processes: changes a module once it is loaded."""

import importlib.machinery
import sys


class Finder:
    """Finds one module as Python does, and changes what it has loaded."""

    def __init__(self, name, change):
        self.name, self.change = name, change

    def find_spec(self, name, path=None, target=None):
        """Return a spec for the module `name` of this finder only; it changes the module after loading."""
        if name != self.name:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        load = spec.loader.exec_module

        def loaded(module):
            load(module)
            self.change(module)

        spec.loader.exec_module = loaded
        return spec


def when_loaded(name, change):
    """Let `change` be called with the module of this name, in this process."""
    sys.meta_path.insert(0, Finder(name, change))
