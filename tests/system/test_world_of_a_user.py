"""A world that a user has written, in a package with an entry point as pip installs it, flies a mission to its goal."""

import importlib

import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.flight import fly_fast

pytestmark = pytest.mark.system
PACKAGE = '''
"""Quadrotors whose body rates are what they are told: v' = -g e3 + (T/m) R e3, R' = R w^, by Euler's method."""

import math

import numpy as np

from crazychoir.types import State

G = 9.80665


class Marbles:
    flies, command_timeout = ("fpqr",), 0.5

    def __init__(self, setup):
        self.ids, self.dt, self.tick = setup.ids, setup.dt, 0
        self.mass = np.array([platform.mass for platform in setup.platforms])
        self.states = np.zeros((len(self.ids), 13))
        self.states[:, :3] = setup.homes
        self.states[:, 9] = 1.0
        self.inputs = np.zeros((len(self.ids), 4))
        self.asked = setup

    @property
    def time(self):
        return self.tick * self.dt

    @property
    def crashed(self):
        return []

    def step(self):
        self.tick += 1
        for row in range(len(self.ids)):
            self._advance(self.states[row], self.inputs[row], self.mass[row], self.dt)

    def _advance(self, x, u, mass, h):
        a, b, c, w = x[6:10]
        z = np.array([2 * (a * c + b * w), 2 * (b * c - a * w), 1 - 2 * (a * a + b * b)])
        x[3:6] += h * (u[0] / mass * z - [0, 0, G])
        x[0:3] += h * x[3:6]
        p, q, r = x[10:13] = u[1:4]
        x[6:10] += h / 2 * np.array([w*p + b*r - c*q, w*q + c*p - a*r, w*r + a*q - b*p, -a*p - b*q - c*r])
        x[6:10] /= np.linalg.norm(x[6:10])
        if x[2] <= 0.0 and u[0] <= mass * G:
            x[2:6], x[6:8] = 0.0, 0.0

    def link(self, i, kind):
        return Way(self, self.ids.index(i))

    def see(self, i, pose):
        pass

    def state(self, i):
        return State(self.states[self.ids.index(i)].copy())

    def resting(self, i):
        return self.states[self.ids.index(i), 2] <= 0.0

    def harm(self, i):
        return ""

    def closest(self):
        far = [(math.dist(p[:3], q[:3]), i, j) for i, p in zip(self.ids, self.states)
               for j, q in zip(self.ids, self.states) if i < j]
        d, i, j = min(far)
        return i, j, d

    def min_separation(self):
        return self.closest()[2]


class Way:
    def __init__(self, world, row):
        self.world, self.row, self.off = world, row, False

    def send(self, command):
        self.world.inputs[self.row] = 0.0 if self.off else command.flat

    def cut(self):
        self.off, self.world.inputs[self.row] = True, 0.0


MADE = []


def world(setup):
    MADE.append(Marbles(setup))
    return MADE[-1]
'''


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The package as pip leaves it: a module, and a folder with what it brings."""
    (tmp_path / "marbles_of_a_user.py").write_text(PACKAGE)
    about = tmp_path / "marbles_of_a_user-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: marbles-of-a-user\nVersion: 1.0\n"
    )
    (about / "entry_points.txt").write_text(
        "[crazychoir.worlds]\nmarbles = marbles_of_a_user:world\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    return importlib.import_module("marbles_of_a_user")


HOP = '''
"""Every drone takes the place of the next one, in a height of its own."""

import numpy as np

from crazychoir import CFGuidance


def goal(config):
    ids = config.ids
    return {i: np.add(config.drone(ids[k - 1]).home, [0.0, 0.0, 0.4 + 0.7 * k]) for k, i in enumerate(ids)}


class Hop(CFGuidance):
    async def mission(self):
        there = goal(self.member.config)[self.id]
        await self.take_off(float(there[2]))
        await self.go_to(there, duration=3.0)
        far = float(np.linalg.norm(self.state.p - there))
        await self.go_to([*self.member.config.drone(self.id).home[:2], there[2]])
        await self.land()
        return {"success": far < 0.02, "reason": f"{far:.3f} m from its goal"}


def guidance(i, config):
    return Hop()
'''


def test_drones_in_a_world_of_another_package_reach_their_goals_and_land(
    installed, tmp_path
):
    (tmp_path / "hop.py").write_text(HOP)
    config = SwarmConfig.of(
        {
            "name": "hop",
            "mission": str(tmp_path / "hop.py"),
            "drones": [
                {"id": k, "home": [0.8 * k, 0.0, 0.0], "uri": "marbles://bag"}
                for k in range(3)
            ],
            "world": {"options": {"colour": "blue"}},
        }
    )
    result = fly_fast(config, load_mission(str(tmp_path / "hop.py")))
    assert result["success"], result["reasons"]
    assert all(far > 2.4 for far in result["flown_m"].values()), result["flown_m"]
    (world,) = installed.MADE
    assert world.asked.options == {"colour": "blue"}
    assert world.asked.uris == 3 * ("marbles://bag",)
    assert world.time >= result["simulated_s"] - 0.1
    assert all(world.resting(i) for i in world.ids), "they have landed"
