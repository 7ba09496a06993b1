"""Which world a uri means: ours, those of other packages, and what is said when one cannot be had."""

import sys
from importlib.metadata import EntryPoint, EntryPoints
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from crazychoir.config import checks
from crazychoir.config.checks import WORLD_ENTRY_POINTS, WORLD_URIS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.choice import SENDERS_BY_KIND
from crazychoir.control.senders import AccSender, DriveSender
from crazychoir.errors import ConfigError
from crazychoir.platforms import CRAZYFLIE_21, PAPER_PLATFORM
from crazychoir.simulation import engines
from crazychoir.simulation.common.world import COMMAND_TYPES
from crazychoir.simulation.engines import count_delay_steps, make_worlds
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.types import FPQR


def swarm(*drones, **tables):
    rows = [
        {"id": i, "home": [float(i), 0.0, 0.0], **drone}
        for i, drone in enumerate(drones)
    ]
    return SwarmConfig.of({"name": "a", "drones": rows, **tables})


def toy(setup):
    """The engine of another package: a lightweight world that keeps what it was asked for."""
    world = CFIntegrator(setup.ids, np.array(setup.homes), dt=setup.dt)
    world.setup = setup
    return world


def broken(setup):
    raise RuntimeError("no licence")


def strange(setup):
    return SimpleNamespace(ids=(99,), dt=0.5)


@pytest.fixture
def installed(monkeypatch):
    """A package that brings the worlds toy://, broken:// and strange://."""
    module = ModuleType("toys")
    module.toy, module.broken, module.strange = toy, broken, strange
    monkeypatch.setitem(sys.modules, "toys", module)
    found = EntryPoints(
        EntryPoint(name, f"toys:{name}", WORLD_ENTRY_POINTS)
        for name in ("toy", "broken", "strange")
    )
    for place in (engines, checks):
        monkeypatch.setattr(
            place, "entry_points", lambda group: found.select(group=group)
        )


def test_a_package_brings_a_world(installed):
    config = swarm(
        {"uri": "toy://hall/1"},
        {},
        {"uri": "toy://hall/2", "platform": "cf21", "yaw": 0.5},
        seed=5,
        world={"options": {"sticky": True}},
        motors={"wind": [0.5, 0.0, 0.0]},
    )
    one, other = make_worlds(config, config.ids)
    assert (one.ids, other.ids) == ((0, 2), (1,))
    asked = one.setup
    assert (asked.ids, asked.uris, asked.seed, asked.dt) == (
        (0, 2),
        ("toy://hall/1", "toy://hall/2"),
        5,
        0.01,
    )
    assert asked.homes == ((0.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    assert (asked.yaws, asked.platforms) == ((0.0, 0.5), (PAPER_PLATFORM, CRAZYFLIE_21))
    assert (asked.options, asked.wind) == ({"sticky": True}, (0.5, 0.0, 0.0))
    assert config.topology.owned == (0, 2)


def test_an_unknown_scheme_is_refused_with_the_list_of_schemes(installed):
    allowed = r"allowed: sim://, .*, mujoco://, replay://FILE, udp://.*, radio://.*, broken://, strange://, toy://"
    with pytest.raises(ConfigError, match=allowed):
        swarm({"uri": "toys://hall"})


@pytest.mark.parametrize(
    ("uri", "said"),
    [
        (
            "broken://",
            r"uri broken://: found RuntimeError: no licence; .*toys:broken is a function of a WorldSetup",
        ),
        (
            "strange://",
            r"uri strange://: found a world of drones \[99\], steps of 0.5 s; .*\[0\], 0.01 s",
        ),
    ],
)
def test_an_engine_that_does_not_work_is_named(installed, uri, said):
    with pytest.raises(ConfigError, match=said):
        make_worlds(swarm({"uri": uri}), (0,))


def test_the_motor_level_world_gets_its_table(monkeypatch):
    module = ModuleType("fake")
    module.world = toy
    monkeypatch.setitem(sys.modules, "fake", module)
    monkeypatch.setitem(
        engines.BUILT_IN_ENGINES,
        WORLD_URIS.motor_level,
        EntryPoint(WORLD_URIS.motor_level, "fake:world", WORLD_ENTRY_POINTS),
    )
    (world,) = make_worlds(
        swarm(
            {"uri": WORLD_URIS.motor_level},
            {"uri": WORLD_URIS.motor_level},
            motors={"battery": 0.5, "gusts": 0.2},
        ),
        (0, 1),
    )
    assert world.setup.options["battery"] == 0.5
    assert world.setup.options["gusts"] == 0.2
    assert world.setup.options["downwash"] is True


def test_lightweight_drones_of_several_platforms_fly_as_what_they_are():
    config = swarm(
        {}, {"platform": "cf21"}, {}, plant={"rate_lag": 0.0, "command_delay": 0.0}
    )
    (made,) = make_worlds(config, config.ids)
    assert made.platforms == (PAPER_PLATFORM, CRAZYFLIE_21, PAPER_PLATFORM)
    (world,) = make_worlds(config, config.ids)
    assert (world.ids, world.platforms) == (
        (0, 1, 2),
        (PAPER_PLATFORM, CRAZYFLIE_21, PAPER_PLATFORM),
    )


def test_only_the_lightweight_world_has_the_delay_in_its_model():
    config = swarm({}, plant={"command_delay": 0.03})
    (lightweight,) = make_worlds(config, (0,))
    assert count_delay_steps(config, lightweight) == 0
    assert count_delay_steps(config, SimpleNamespace(dt=0.01)) == 3


def test_a_link_for_what_a_world_does_not_fly_is_refused_when_it_is_made():
    (world,) = make_worlds(swarm({}), (0,))
    world.link(0, "fpqr").send(FPQR(np.zeros(4)))
    with pytest.raises(
        ConfigError,
        match="drone 0: sender: found frpy; allowed: fpqr: what its world flies",
    ):
        world.link(0, "frpy")


def test_every_sender_of_a_swarm_file_has_a_kind_of_commands():
    assert [*SENDERS_BY_KIND, "acc", "drive"] == list(COMMAND_TYPES)
    for name, sender in (
        SENDERS_BY_KIND | {"acc": AccSender, "drive": DriveSender}
    ).items():
        assert isinstance(sender().message(np.zeros(5)), COMMAND_TYPES[name])
        assert isinstance(sender().idle, COMMAND_TYPES[name])
