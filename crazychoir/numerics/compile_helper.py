"""The program of a process that helps to compile laws, see compile_helpers."""

import contextlib
import importlib
import json
import os
import sys

from crazychoir.numerics.compile_helpers import LawNames, take_number
from crazychoir.numerics.compiling import KERNEL_QUEUE


def main() -> None:
    """Compile laws until none is left or the process that waits for them has ended.

    Arguments: file descriptor of the pipe with the numbers of the laws, number of the waiting process.
    Standard input: the names of the laws.
    """
    pipe = int(sys.argv[1])
    waiting = int(sys.argv[2])
    names: LawNames = [(module, law) for module, law in json.load(sys.stdin)]
    with KERNEL_QUEUE.checks_first():
        for module in dict.fromkeys(module for module, _ in names):
            with contextlib.suppress(ImportError):  # of a user, known by its path alone
                importlib.import_module(module)

    def take_next() -> int | None:
        return take_number(pipe) if os.getppid() == waiting else None

    KERNEL_QUEUE.compile_shared(take_next, names)


if __name__ == "__main__":
    main()
