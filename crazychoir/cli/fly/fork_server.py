"""The fork server of `crazychoir run`: it imports what the processes of a swarm import, and forks them.

Laws that are kept on disk are loaded at once, and called in a short flight. Missing laws are compiled
when `run` has checked the swarm: errors in a swarm file are reported before anything is compiled.
"""

import contextlib
import socket
import sys

import typer

from crazychoir.cli.fly.process_command import limit_matrix_threads
from crazychoir.launch.fork_server import ForkRequest
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
    if not KERNEL_QUEUE.count_waiting():
        _fly_once()
    with socket.socket(fileno=int(sys.argv[1])) as requests:
        program = serve_forks(requests, _compile_missing_laws, _preload_swarm)
    if program is not None:
        program.run()


def _compile_missing_laws() -> None:
    """Compile the laws that are not kept on disk, and call all in a short flight."""
    if KERNEL_QUEUE.count_waiting():
        KERNEL_QUEUE.compile()
        _fly_once()


def _preload_swarm(request: ForkRequest) -> bool:
    """Read the swarm file of an agent, and return whether that was done now for the first time."""
    from crazychoir.launch.process.preloading import PRELOADED_SWARMS
    from crazychoir.launch.processes import AGENT_MODULE, SWARM_OPTION

    if request.module != AGENT_MODULE or SWARM_OPTION not in request.words:
        return False
    path = request.words[request.words.index(SWARM_OPTION) + 1]
    with contextlib.suppress(Exception):  # the agent reports its error
        return PRELOADED_SWARMS.preload(path)
    return False


def _fly_once() -> None:
    """Make a short flight; its imports are those of `_import_agent`."""
    from crazychoir.launch.process.warm_flight import fly_once

    fly_once()


def _import_agent() -> None:
    """Import what an agent imports."""
    import uvloop  # noqa: F401

    import crazychoir.cli.shared.chosen_swarm
    import crazychoir.guidance.mission
    import crazychoir.launch.process.preloading
    import crazychoir.launch.process.process
    import crazychoir.launch.process.warm_flight
    import crazychoir.launch.processes  # noqa: F401
    from crazychoir.cli.fly import agent

    # typer imports for a tenth of a second when it reads a first command line.
    typer.main.get_command(agent.app).make_context("agent", ["--id", "0"])


if __name__ == "__main__":
    main()
