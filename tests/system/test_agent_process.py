"""What an agent of `crazychoir run` holds: its modules, its threads, its memory."""

from textwrap import dedent

import pytest
from system.commands import call, run

MISSION = dedent("""
    import sys
    from pathlib import Path
    from crazychoir import CFGuidance

    ROLLUP = Path("/proc/self/smaps_rollup")
    THREADS = Path("/proc/self/task")

    class Looking(CFGuidance):
        async def mission(self):
            await self.take_off(0.3)
            await self.land()
            memory = dict(
                line.split()[:2] for line in ROLLUP.read_text().splitlines()[1:]
            )
            return {
                "modules": [name for name in UNUSED if name in sys.modules],
                "threads": len(list(THREADS.iterdir())),
                "memory_mib": int(memory["Pss:"]) / 1024.0,
            }

    def guidance(i, config):
        return Looking()
""")
UNUSED = (
    "matplotlib",
    "cvxpy",
    "cryptography",
    "highspy",
    "cflib",
    "mujoco",
    "scipy.spatial",
    "scipy.special",
    "scipy.optimize",
    "crazychoir.radio.owner",
    "crazychoir.simulation.motor_level",
    "crazychoir.simulation.onboard",
    "crazychoir.routing",
)
"""Modules that an agent with a simulated drone does not need."""
SIX = ("--drones", 6, "--processes", 6)
MOST_THREADS = 24
"""Threads of an agent."""
MOST_MEMORY = 70.0
"""MiB: memory of each of six agents; a page that they share counts in parts."""


@pytest.fixture
def mission(tmp_path):
    file = tmp_path / "looking.py"
    file.write_text(f"UNUSED = {UNUSED!r}\n{MISSION}")
    return file


@pytest.mark.real_time
@pytest.mark.timeout(120)
def test_six_agents_import_what_they_use_and_share_it(mission, compiled):
    flown = run(mission, *SIX)
    assert flown["success"], flown["reasons"]
    agents = flown["results"].values()
    assert len(agents) == 6
    assert [agent["modules"] for agent in agents] == [[]] * 6
    assert max(agent["threads"] for agent in agents) <= MOST_THREADS
    assert max(agent["memory_mib"] for agent in agents) <= MOST_MEMORY


@pytest.mark.parametrize(
    ("text", "code", "says"),
    [
        ("import no_such_module", 2, "broken.py:1: found ModuleNotFoundError"),
        ("def guidance(i, config): raise ValueError('no law')", 1, "no law"),
        ("import os; os._exit(7)", 7, ""),
    ],
)
@pytest.mark.real_time
def test_a_broken_mission_is_told(tmp_path, text, code, says, compiled):
    file = tmp_path / "broken.py"
    file.write_text(text)
    said = call("crazychoir", "run", file, "--drones", 2)
    assert said.code == code
    assert says in said.err
