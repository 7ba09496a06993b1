"""crazychoir new: a mission and a swarm file to begin with."""

from pathlib import Path
from typing import Annotated

import typer

from crazychoir.cli.operate.inspect import JsonOption
from crazychoir.cli.setup.new_files import write_new_files
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    exit_with_error,
    set_up_logging,
    write_json,
)

NEW_MISSION = '''"""{name}: four drones agree on one height.  u_i = - kp sum_j (z_i - z_j) - kv vz_i,  j: neighbours.

Fly it in virtual time: crazychoir run {name}.toml --fast
In real time, with 20 % of the messages lost: crazychoir run {name}.toml --loss 0.2
"""

import numpy as np

from crazychoir import Acceleration, CFDistributedFeedback


class SameHeight(CFDistributedFeedback):
    """The law of one drone; `step` is called for each of its ticks."""

    duration = 10.0                            # s after the take-off; then the drone lands

    def __init__(self, kp, kv):
        self.kp = kp
        self.kv = kv

    def height(self):                          # m, of the take-off
        return 0.6 + 0.2 * self.id

    def step(self, me, heard):                 # me: State; heard: {{j: State}} of the neighbours, without stale ones
        away = sum(me.p[2] - other.p[2] for other in heard.values())
        u = -self.kp * away - self.kv * me.v[2]
        return Acceleration(np.array([0.0, 0.0, u]))    # m/s2, world: x, y, z up


def guidance(i, config):                       # the guidance of drone i
    options = config.mission_options           # of the swarm file
    return SameHeight(options.get("kp", 2.0), options.get("kv", 2.0))


def report(config, results):                   # success: all drones end within 2 cm of one height
    heights = [result.get("place", [np.nan] * 3)[2] for result in results.values()]   # nan: this drone failed
    spread = np.ptp(heights)
    return {{"mean_z": np.mean(heights), "spread_m": spread, "success": bool(spread < 0.02)}}
'''
"""The mission file."""
NEW_SWARM = """# {name}: crazychoir run {name}.toml --fast
# All keys: https://github.com/crazychoir/crazychoir/blob/main/deploy/REFERENCE.md
name = "{name}"
mission = "{name}.py"
graph = "ring"              # each drone talks to two others
seed = 1

[mission_options]           # for your mission
kp = 2.0
kv = 2.0

[network]
loss = 0.0                  # share of messages between drones that is lost

[fence]                     # m: no drone leaves this box
min = [-1.5, -1.5, 0.0]
max = [1.5, 1.5, 2.5]

[[drones]]
id = 0
home = [0.6, 0.6, 0.0]      # m: where it stands
uri = "sim://"              # or "sim://motors", "mujoco://", "radio://0/80/2M/E7E7E7E700"

[[drones]]
id = 1
home = [-0.6, 0.6, 0.0]

[[drones]]
id = 2
home = [-0.6, -0.6, 0.0]

[[drones]]
id = 3
home = [0.6, -0.6, 0.0]
"""
"""The swarm file."""


def new(
    name: Annotated[
        str,
        typer.Argument(
            help="Name of the mission: letters, digits and _, as in my_law."
        ),
    ],
    as_json: JsonOption = False,
) -> None:
    """Write a mission and a swarm file to begin with into this folder; they fly at once."""
    set_up_logging()
    try:
        if not name.isidentifier() or not name.isascii():
            raise ConfigError(
                "NAME", name, "letters, digits and _, a letter first, as in my_law"
            )
        texts = {
            f"{name}.py": NEW_MISSION.format(name=name),
            f"{name}.toml": NEW_SWARM.format(name=name),
        }
        written = [str(path) for path in write_new_files(Path(), texts)]
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    if as_json:
        write_json({"written": written})
    else:
        ANSWER_CONSOLE.print(
            f"Wrote {' and '.join(written)}. Fly them: crazychoir run {name}.toml --fast",
            highlight=False,
            soft_wrap=True,
        )
