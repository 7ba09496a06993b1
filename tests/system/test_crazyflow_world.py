"""The example of an engine in a package of its own flies crazyflow; a stub stands for it where it is not installed."""

import importlib.metadata
import sys
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np
import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.flight import fly_fast

pytestmark = pytest.mark.system
FREE_FALL = np.array([0.0, 0.0, -9.81])
HOP = '''
"""Take off, fly 0.5 m to the side, land."""

import numpy as np

from crazychoir import CFGuidance


class Hop(CFGuidance):
    async def mission(self):
        there = self.state.p + [0.5, 0.0, 0.8]
        await self.take_off(float(there[2]))
        await self.go_to(there, duration=2.0)
        far = float(np.linalg.norm(self.state.p - there))
        await self.land()
        return {"success": far < 0.05, "reason": f"{far:.3f} m from its goal"}


def guidance(i, config):
    return Hop()
'''


@dataclass
class Rows:
    """An array that is changed as jax's are: rows.at[0].set(values) returns a copy."""

    values: np.ndarray

    @property
    def at(self):
        return Places(self.values)

    def __getitem__(self, key):
        return self.values[key]


@dataclass
class Places:
    """The places of an array; one is chosen by its key, and set in a copy."""

    values: np.ndarray
    key: int = 0

    def __getitem__(self, key):
        return Places(self.values, key)

    def set(self, new):
        changed = self.values.copy()
        changed[self.key] = new
        return Rows(changed)


@dataclass
class Bodies:
    pos: Rows
    quat: Rows
    vel: Rows
    ang_vel: Rows
    replace = replace


@dataclass
class Data:
    states: Bodies
    replace = replace


def rows(n, width):
    return Rows(np.zeros((1, n, width)))


class StubSim:
    """Quadrotors with exact body rates, by Euler's method, with the interface of crazyflow's Sim."""

    MASS = 0.0319

    def __init__(self, n_drones, freq, **others):
        self.asked = others
        self.h = 1.0 / freq
        quat = rows(n_drones, 4)
        quat.values[..., 3] = 1.0
        bodies = Bodies(rows(n_drones, 3), quat, rows(n_drones, 3), rows(n_drones, 3))
        self.data = Data(bodies)

    def body_rate_control(self, commands):
        self.commands = np.asarray(commands)[0]

    def step(self, steps):
        seen = self.data.states
        p, q, v = (np.array(part[0]) for part in (seen.pos, seen.quat, seen.vel))
        w = self.commands[:, 0:3]
        for _ in range(steps):
            a, b, c, d = q.T
            up = np.stack(
                [2 * (a * c + b * d), 2 * (b * c - a * d), 1 - 2 * (a * a + b * b)]
            )
            v = v + self.h * (FREE_FALL + (self.commands[:, 3] / self.MASS * up).T)
            v[(p[:, 2] <= 0.0) & (v[:, 2] < 0.0)] = 0.0
            p = p + self.h * v
            x, y, z = w.T
            turn = [
                d * x + b * z - c * y,
                d * y + c * x - a * z,
                d * z + a * y - b * x,
                -a * x - b * y - c * z,
            ]
            q = q + 0.5 * self.h * np.stack(turn).T
            q = q / np.linalg.norm(q, axis=1, keepdims=True)
        self.data = Data(
            Bodies(*(Rows(part[None]) for part in (p, q, v, np.array(w, float))))
        )


@pytest.fixture
def crazyflow_world(repository, tmp_path, monkeypatch):
    """Install the example as pip leaves it, beside a stub of crazyflow."""
    for name, content in {
        "crazyflow": {},
        "crazyflow.sim": {"Sim": lambda n_worlds, **options: StubSim(**options)},
        "crazyflow.control": {"Control": type("Control", (), {"body_rate": "rate"})},
        "crazyflow.dynamics": {
            "Dynamics": type("Dynamics", (), {"first_principles": "first"})
        },
    }.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    about = tmp_path / "crazychoir_crazyflow_world-0.1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: crazychoir-crazyflow-world\nVersion: 0.1.0\n"
    )
    (about / "entry_points.txt").write_text(
        "[crazychoir.worlds]\ncrazyflow = crazyflow_world:engine\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.syspath_prepend(str(repository / "docs" / "crazyflow_world"))
    yield
    sys.modules.pop("crazyflow_world", None)


@pytest.mark.usefixtures("crazyflow_world")
def test_drones_take_off_fly_and_land_in_crazyflow(tmp_path):
    (tmp_path / "hop.py").write_text(HOP)
    config = SwarmConfig.of(
        {
            "name": "hop",
            "mission": str(tmp_path / "hop.py"),
            "drones": [
                {
                    "id": i,
                    "home": [0.0, float(i), 0.0],
                    "uri": "crazyflow://",
                    "platform": "cf21",
                }
                for i in range(2)
            ],
        }
    )
    result = fly_fast(config, load_mission(config.mission))
    assert result["success"], result["reasons"]
    assert all(far > 1.5 for far in result["flown_m"].values()), result["flown_m"]


def test_example_declares_its_entry_point(repository):
    text = (repository / "docs" / "crazyflow_world" / "pyproject.toml").read_text()
    assert 'crazyflow = "crazyflow_world:engine"' in text
    assert importlib.metadata.version("crazychoir")
