"""Check that dongles can carry a swarm's packets, and plan what they send."""

from crazychoir.config.dongle_plan import DonglePlan, plan_dongle
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.robots import find_sender


def plan_dongles(config: SwarmConfig) -> dict[int, DonglePlan]:
    """Return the plan of each dongle.

    Raises ConfigError if a dongle cannot carry its drones.
    """
    senders = {i: find_sender(config, i) for i in config.topology.reached}
    return {
        dongle: plan_dongle(config, dongle, senders)
        for dongle in config.topology.dongles
    }


def compute_setpoint_rates(config: SwarmConfig) -> dict[int, float]:
    """Return the set-point rate in Hz for each dongle.

    Raises ConfigError if a dongle cannot carry its drones.
    """
    return {dongle: plan.setpoint_rate for dongle, plan in plan_dongles(config).items()}
