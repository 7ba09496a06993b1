"""A process that flies the runs of a sweep, one after the other: it imports and loads laws once.

It reads a run as a line of JSON from standard input, and writes its row as a line of JSON to standard
output, until the input ends.
"""

import ctypes
import json
import os
import signal
import sys
from typing import Any, TextIO

from crazychoir.api.sweep_rows import Row, build_first_figures, build_row
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import CrazyChoirError, error_text, refuse_exit
from crazychoir.guidance.mission import Mission, load_mission
from crazychoir.launch.flight import fly_fast

PR_SET_PDEATHSIG = 1
"""Option of prctl(2): a signal at the end of the parent."""


def fly_run(config: SwarmConfig, mission: Mission) -> Row:
    """Fly in virtual time, and return the row. An error of the mission is the reason of its row."""
    try:
        with refuse_exit("the mission"):
            return build_row(fly_fast(config, mission))
    except CrazyChoirError as error:
        return build_first_figures(False, f"{type(error).__name__}: {error}")
    except Exception as error:  # noqa: BLE001 - a failed run is a row of the table
        return build_first_figures(False, error_text(error))


def _serve(answers: TextIO) -> None:
    """Fly each run of standard input, and write its row."""
    missions: dict[str, Mission] = {}
    for line in sys.stdin:
        run: dict[str, Any] = json.loads(line)
        config = SwarmConfig.loads(run["swarm"])
        name = str(config.mission)
        if name not in missions:
            missions[name] = load_mission(name)
        answers.write(json.dumps(fly_run(config, missions[name])) + "\n")
        answers.flush()


def main() -> None:
    """Run the process. What a mission prints goes to standard error."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)
        _serve(answers)


if __name__ == "__main__":
    main()
