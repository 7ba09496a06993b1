"""Check that dongles can carry a swarm's packets, and compute the rate of set-points."""

from crazychoir.config.radio_checks import carried_rate
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.robots import find_sender


def compute_setpoint_rates(config: SwarmConfig) -> dict[int, float]:
    """Return the set-point rate in Hz for each dongle.

    Raises ConfigError if a dongle cannot carry its drones.
    """
    senders = {i: find_sender(config, i) for i in config.topology.reached}
    return {
        dongle: carried_rate(config, dongle, senders)
        for dongle in config.topology.dongles
    }
