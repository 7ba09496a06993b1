"""The fork server of `crazychoir run`: it imports what the processes of a swarm import, and forks them.

Laws that are kept on disk are loaded at once. Missing laws are compiled when `run` has checked the
swarm: errors in a swarm file are reported before anything is compiled.
"""

import socket
import sys

import typer

from crazychoir.cli.fly.process_command import limit_matrix_threads
from crazychoir.launch.process.ending import end_after_parent
from crazychoir.launch.process.forking import serve_forks
from crazychoir.numerics.compiling import KERNEL_QUEUE


def main() -> None:
    """Serve the socket with the file descriptor in the command line."""
    limit_matrix_threads(may_have_more=False)  # it forks, so it has one thread
    end_after_parent()
    with KERNEL_QUEUE.checks_first():
        _import_agent()
    KERNEL_QUEUE.load_kept()
    with socket.socket(fileno=int(sys.argv[1])) as requests:
        program = serve_forks(requests, KERNEL_QUEUE.compile)
    if program is not None:
        program.run()


def _import_agent() -> None:
    """Import what an agent imports."""
    import uvloop  # noqa: F401

    import crazychoir.cli.shared.chosen_swarm
    import crazychoir.guidance.mission
    import crazychoir.launch.process.process
    import crazychoir.launch.processes  # noqa: F401
    from crazychoir.cli.fly import agent

    # typer imports for a tenth of a second when it reads a first command line.
    typer.main.get_command(agent.app).make_context("agent", ["--id", "0"])


if __name__ == "__main__":
    main()
