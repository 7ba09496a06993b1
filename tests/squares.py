"""A swarm file with four drones on a square."""

from crazychoir.config.swarm_config import SwarmConfig

SQUARE = """
name = "square"
seed = 3
{keys}
[[drones]]
id = 0
home = [0, 0, 0]
{first}
[[drones]]
id = 1
home = [1, 0, 0]
[[drones]]
id = 2
home = [1, 1, 0]
[[drones]]
id = 3
home = [0, 1, 0]
{last}
"""


def square(keys: str = "", first: str = "", last: str = "") -> SwarmConfig:
    return SwarmConfig.loads(
        SQUARE.format(keys=keys, first=first, last=last), "square.toml"
    )
