"""The flights of one process of a sweep: a row for each run."""

import json
import sys
from typing import Any, TextIO

from crazychoir.api.sweep_rows import Row, build_first_figures, build_row
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import CrazyChoirError, error_text, refuse_exit
from crazychoir.guidance.mission import Mission, check_before_flight, load_mission
from crazychoir.launch.flight import fly_fast
from crazychoir.numerics.compiling import KERNEL_QUEUE


def fly_run(config: SwarmConfig, mission: Mission) -> Row:
    """Fly in virtual time, and return the row. An error of the mission is the reason of its row."""
    try:
        with refuse_exit("the mission"):
            check_before_flight(mission, config)
            return build_row(fly_fast(config, mission))
    except CrazyChoirError as error:
        return build_first_figures(False, f"{type(error).__name__}: {error}")
    except Exception as error:  # noqa: BLE001 - a failed run is a row of the table
        return build_first_figures(False, error_text(error))


def fly_runs_of_input(answers: TextIO) -> None:
    """Fly each run of standard input, a line of JSON, and write its row, until the input ends.

    Laws are compiled when the first run comes: then the sweep itself has compiled and kept them.
    """
    missions: dict[str, Mission] = {}
    for line in sys.stdin:
        KERNEL_QUEUE.compile()
        run: dict[str, Any] = json.loads(line)
        config = SwarmConfig.loads(run["swarm"])
        name = str(config.mission)
        if name not in missions:
            missions[name] = load_mission(name)
        answers.write(json.dumps(fly_run(config, missions[name])) + "\n")
        answers.flush()
