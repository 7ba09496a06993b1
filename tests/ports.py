"""Ports for tests that start their own processes."""

import contextlib

from crazychoir.config.addresses import LOCAL_ADDRESS
from crazychoir.errors import ConfigError
from crazychoir.launch.network import reserve_ports


def is_free(port):
    """Return whether a process could take the port now."""
    with contextlib.suppress(ConfigError), reserve_ports({0: LOCAL_ADDRESS}, port):
        return True
    return False


def free_ports(offsets):
    """Return a base port such that base + offset was free a moment ago for each offset."""
    with reserve_ports(dict.fromkeys(offsets, LOCAL_ADDRESS)) as base:
        return base
