"""The fork server of `crazychoir run` imports what the processes of a swarm import."""

import json
import subprocess
import sys

PROGRAM = """
import json, sys
import typer
from crazychoir.cli.fly import fork_server

fork_server._import_agent()
before = set(sys.modules)
from crazychoir.cli.fly import agent

command = typer.main.get_command(agent.app)
command.make_context("agent", ["--id", "3", "--swarm", "swarm.json", "--child", "result-3"])
print(json.dumps(sorted(set(sys.modules) - before)))
"""


def test_agent_has_nothing_to_import_for_its_command_line():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout) == []
