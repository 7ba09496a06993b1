"""The command lines as a user calls them."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crazychoir.config.swarm_config import SwarmConfig

PROGRAMS = {
    "crazychoir": (sys.executable, "-m", "crazychoir.cli.main"),
    "crazychoir-agent": (sys.executable, "-m", "crazychoir.cli.fly.agent"),
    "crazychoir-world": (sys.executable, "-m", "crazychoir.cli.fly.world"),
    "crazychoir-mocap": (sys.executable, "-m", "crazychoir.cli.fly.mocap"),
}


@dataclass(frozen=True)
class Said:
    """How a command ended: exit code, standard output, standard error."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """Standard output, which must be one JSON object and nothing else."""
        return json.loads(self.out)

    def refuses(self, *words: str, code: int = 2) -> None:
        """Assert a clear error: the exit code, each of the words, no traceback."""
        assert self.code == code, self.err
        assert "Traceback" not in self.err, self.err
        for word in words:
            assert word in self.err, self.err


def call(
    program: str, *words: object, seconds: float = 60.0, **environment: str
) -> Said:
    """Run a command to its end."""
    command = [*PROGRAMS[program], *map(str, words)]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=seconds,
        check=False,
        env={**os.environ, **environment},
    )
    return Said(done.returncode, done.stdout, done.stderr)


def fly(
    config: SwarmConfig, folder: Path, *words: object, seconds: float = 110.0
) -> dict[str, Any]:
    """`crazychoir run` of a swarm file, in real time; its object."""
    path = folder / "swarm.json"
    path.write_text(config.dumps())
    return run(path, *words, seconds=seconds)


def run(*words: object, seconds: float = 60.0, **environment: str) -> dict[str, Any]:
    """`crazychoir run ... --json`; its object."""
    said = call("crazychoir", "run", *words, "--json", seconds=seconds, **environment)
    assert said.out, said.err
    result: dict[str, Any] = said.json
    assert said.code == (0 if result["success"] else 1)
    return result
