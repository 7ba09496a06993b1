"""crazychoir router: forward messages between hosts of a swarm that cannot reach each other."""

import signal
from typing import Annotated

import typer

from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.launch.console import ERROR_CONSOLE, exit_with_error, set_up_logging

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end the router."""


def router(
    swarm: Annotated[
        str | None, typer.Option(help="Swarm file; else ./swarm.toml.")
    ] = None,
    listen: Annotated[
        str | None,
        typer.Option(
            help="Zenoh endpoint, as tcp/0.0.0.0:7441, instead of the swarm file's."
        ),
    ] = None,
) -> None:
    """Run a Zenoh router for hosts that cannot reach each other.

    The router runs until Ctrl-C.
    """
    set_up_logging()
    # The threads of Zenoh inherit this mask, so that only sigwait receives these signals.
    unmasked = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
    from crazychoir.bus.network.zenoh_session import route_messages
    from crazychoir.config.access import access_of
    from crazychoir.config.addresses import Addresses
    from crazychoir.config.swarm_config import find_swarm

    try:
        config, which = find_swarm(swarm)
        if config.router is None and (listen is None or config.secured):
            do = 'Write router = "NAME", a name of [hosts], above the first table: all processes then connect to it.'
            raise ConfigError(
                f"{which}: router", "nothing", "the host that it runs on", do
            )
        at = Addresses(config).routers if listen is None else [listen]
        access = access_of(config, config.router or "", *at)
        with route_messages(at, config.lease, access):
            closed = "mutual TLS" if access is not None else "open to all"
            ERROR_CONSOLE.print(
                f"swarm {config.name} ({which}): router at {', '.join(at)}, {closed}",
                markup=False,
            )
            signal.sigwait(ENDING_SIGNALS)
    except CrazyChoirError as error:
        exit_with_error(error, as_json=False)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, unmasked)
