"""Names of options in the errors of the Python interface."""

import contextlib
from collections.abc import Iterator

from crazychoir.errors import ConfigError

OPTION_ARGUMENTS = ("drones", "swarm", "loss", "seed", "fast", "graph")
"""Arguments of the Python interface that are options of the command line."""


@contextlib.contextmanager
def naming_options() -> Iterator[None]:
    """Name the option, as --drones, in each error that names an argument of the Python interface."""
    try:
        yield
    except ConfigError as error:
        if error.where not in OPTION_ARGUMENTS:
            raise
        raise ConfigError(
            f"--{error.where}", error.found, error.allowed, error.do, error.problem
        ) from error
