"""A command of crazychoir that lands its drones and ends when the program that started it ends."""

import runpy
import sys

from crazychoir.launch.process.ending import end_after_parent

if __name__ == "__main__":
    end_after_parent()
    sys.argv[0] = "crazychoir"
    runpy.run_module("crazychoir", run_name="__main__")
