"""Whether the dongles carry what a swarm would send, and how many set-points a second they leave."""

from crazychoir.config.radio_checks import carried
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.robots import sender_of


def rates(config: SwarmConfig) -> dict[int, float]:
    """Hz of set-points, by dongle; ConfigError where one does not carry them."""
    senders = {i: sender_of(config, i) for i in config.reached}
    return {dongle: carried(config, dongle, senders) for dongle in config.dongles}
