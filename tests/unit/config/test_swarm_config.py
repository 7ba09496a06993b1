"""The swarm file: what it says, round trips, digests, endpoints, the built-in swarms."""

import math
import re
import tomllib
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from squares import SQUARE, square

from crazychoir.config.addresses import Addresses
from crazychoir.config.digest import compute_digest
from crazychoir.config.swarm_config import (
    SwarmConfig,
    default_swarm,
    demo_swarm,
    find_swarm,
)
from crazychoir.config.tables import NetworkTable
from crazychoir.errors import ConfigError
from crazychoir.team.graph import (
    Graph,
    erdos_renyi_connected,
    graph_from_name,
    path,
    ring,
)

ROOT = Path(__file__).parents[3]


finite = st.floats(-3, 3, allow_nan=False)
plain = st.recursive(
    st.booleans()
    | st.integers(-(2**62), 2**62)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text(min_size=1), inner, max_size=3)
    ),
    max_leaves=8,
)
free = st.dictionaries(st.text(min_size=1), plain, max_size=3)


@st.composite
def swarms(draw: st.DrawFn) -> dict[str, object]:
    """Plain values of a swarm file that holds all rules."""
    ids = draw(st.lists(st.integers(0, 9999), min_size=1, max_size=6, unique=True))
    hosts = draw(
        st.sampled_from(
            [{}, {"a": "10.0.0.1", "b-2": "lab.example.org", "c": "fe80::1"}]
        )
    )
    drones = []
    for n, i in enumerate(ids):
        drone = {
            "id": i,
            "home": [n - 3, draw(finite), 0.5],
            "yaw": draw(finite),
            "leader": draw(st.booleans()),
        }
        drone |= {"role": draw(st.text()), "options": draw(free)}
        drone |= {"host": draw(st.sampled_from(list(hosts)))} if hosts else {}
        drones.append(drone)
    edges = (
        draw(st.lists(st.permutations(ids).map(lambda order: order[:2]), max_size=4))
        if len(ids) > 1
        else []
    )
    network = {
        "loss": draw(st.floats(0, 1)),
        "edges": [{"source": ids[0], "delay": 0.1}],
    }
    return {
        "name": draw(st.from_regex(r"[a-z0-9_-]{1,40}", fullmatch=True)),
        "mission_options": draw(free),
        "seed": draw(st.integers(0, 2**63 - 1)),
        **draw(
            st.sampled_from(
                [
                    {"graph": "path"},
                    {"edges": edges, "directed": True},
                    {"edges": edges},
                    {},
                ]
            )
        ),
        "hosts": hosts,
        "security": {"operators": list(hosts)},
        "network": draw(st.sampled_from([{}, network])),
        "drones": drones,
    }


@settings(max_examples=40)
@given(swarms())
def test_round_trip_through_text_keeps_everything(raw: dict[str, object]) -> None:
    config = SwarmConfig.of(raw)
    again = SwarmConfig.loads(config.dumps())
    assert again == config
    assert compute_digest(again) == compute_digest(config)
    assert again.dumps() == config.dumps()
    assert config.replace() == config
    for name in ("name", "mission_options", "seed", "hosts"):
        assert getattr(config, name) == raw[name]


@given(swarms())
def test_processes_cover_the_swarm_and_endpoints_differ(raw: dict[str, object]) -> None:
    config = SwarmConfig.of(raw)
    assert (
        sorted(i for group in Addresses(config).groups() for i in group)
        == list(config.ids)
        == list(config.graph().ids)
    )
    assert len(dict.fromkeys(Addresses(config).endpoints().values())) == len(
        Addresses(config).groups()
    )


@given(st.text(max_size=60) | st.text(alphabet='{}[]=".,\n0123456789abc', max_size=60))
def test_any_text_is_a_swarm_or_a_config_error(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^x\.toml"):
        SwarmConfig.loads(text, "x.toml")


def test_defaults() -> None:
    config = square()
    assert (config.start, config.start_deadline, config.lost_after, config.lease) == (
        "all",
        30.0,
        5.0,
        1.0,
    )
    assert (config.base_port, config.mission, config.processes, config.hosts) == (
        7460,
        None,
        None,
        {},
    )
    assert (config.mocap.rate, config.plant.inputs, config.flight.takeoff_height) == (
        100.0,
        "rates",
        1.0,
    )
    assert config.drone(1).home == (1.0, 0.0, 0.0)
    assert config.drone(1).uri == "sim://"
    assert config.network == NetworkTable()
    assert config.graph() == ring(4)


@pytest.mark.parametrize(
    ("keys", "graph"),
    [
        ('graph = "path"', path(4)),
        ('graph = "erdos-renyi:0.5"', graph_from_name("erdos-renyi:0.5", 4, seed=3)),
        ("edges = [[0, 1], [3, 2]]", Graph.from_edges(4, [(0, 1), (2, 3)])),
        (
            "edges = [[0, 1], [3, 2]]\ndirected = true",
            Graph.from_edges(4, [(0, 1), (3, 2)], directed=True),
        ),
        ("directed = true", ring(4, directed=True)),
        (
            'graph = "erdos-renyi:0.5"\ndirected = true',
            erdos_renyi_connected((0, 1, 2, 3), 0.5, seed=3, directed=True),
        ),
        ("edges = []", Graph.from_edges(4, [])),
    ],
)
def test_graphs(keys: str, graph: Graph) -> None:
    assert square(keys).graph() == graph


def test_neighbors_are_the_drones_that_a_drone_hears() -> None:
    raw = tomllib.loads(SQUARE.format(keys="directed = true", first="", last=""))
    for drone, heard in zip(raw["drones"], ([], [0], [1, 0], [2]), strict=True):
        drone["neighbors"] = heard
    graph = SwarmConfig.of(raw).graph()
    assert graph.arcs == ((0, 1), (0, 2), (1, 2), (2, 3))
    assert graph.in_neighbors(2) == (0, 1)


def test_replace_checks_again() -> None:
    config = square()
    assert config.replace(graph="path", seed=8).graph() == path(4)
    assert config.replace(network={"loss": 0.3}).network == NetworkTable(loss=0.3)
    assert config.replace(
        drones=[msgspec.structs.replace(config.drone(2), id=9)]
    ).ids == (9,)
    assert config.replace(processes=[[0, 1, 2, 3]]).replace(processes=None) == config
    with pytest.raises(ConfigError, match=r"^swarm square: start: found 5; allowed"):
        config.replace(start=5)
    with pytest.raises(ConfigError, match="Did you mean graph"):
        config.replace(grap="ring")


def test_another_network_effect_keeps_the_other_keys() -> None:
    edge = {"source": 0, "destination": 1, "loss": 0.5}
    cut = {"at": 2.0, "groups": [[1]]}
    network = {"loss": 0.1, "delay": 0.02, "edges": [edge], "partitions": [cut]}
    config = square().replace(network=network)
    assert config.with_network(loss=0.3) == config.replace(
        network={**network, "loss": 0.3}
    )
    assert config.with_network(loss=0.1) == config


@pytest.mark.parametrize("effects", [{"loss": 1.5}, {"burst": 0.5}, {"loss": math.nan}])
def test_network_effects_are_checked_as_in_a_file(effects: dict[str, float]) -> None:
    with pytest.raises(ConfigError) as of_a_file:
        square().replace(network=effects)
    with pytest.raises(ConfigError) as found:
        square().with_network(**effects)
    assert str(found.value) == str(of_a_file.value)


@pytest.mark.parametrize("n", [1, 2, 7, 30, 1000])
def test_default_swarm(n: int) -> None:
    config = default_swarm(n)
    assert config.ids == tuple(range(n))
    assert config.graph() == ring(n)


def test_demo_swarm() -> None:
    config = demo_swarm()
    assert (config.name, config.mission, config.graph()) == (
        "demo",
        "pickup_delivery",
        ring(6),
    )
    assert [drone.home[:2] for drone in config.drones] == [
        (x, y) for y in (0.0, 0.6) for x in (0.0, 0.6, 1.2)
    ]


def test_find_swarm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_swarm(None) == (
        demo_swarm(),
        "the built-in demo swarm: six drones, pickup_delivery",
    )
    Path("swarm.toml").write_text(SQUARE.format(keys="", first="", last=""))
    assert find_swarm(None) == (square(), "swarm.toml of this folder")
    Path("other.json").write_text(default_swarm(2).dumps())
    assert find_swarm("other.json") == (default_swarm(2), "other.json")


@pytest.mark.parametrize(
    "file",
    ["lab6.toml", "two_hosts.toml", "mujoco30.toml", "virtual4.toml", "virtual12.toml"],
)
def test_the_examples_of_deploy_load(file: str) -> None:
    config = SwarmConfig.load(ROOT / "deploy" / file)
    assert config.name == Path(file).stem
    assert config.graph().is_connected
    assert (
        len(config.drones)
        == {"lab6": 6, "two_hosts": 4, "mujoco30": 30, "virtual4": 4, "virtual12": 12}[
            config.name
        ]
    )
    assert SwarmConfig.loads(config.dumps()) == config


def _sections() -> dict[str, str]:
    """Return the sections of the reference of keys, by heading."""
    text = (ROOT / "deploy" / "REFERENCE.md").read_text()
    parts = re.split(r"^## (.*)$", text, flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def test_the_reference_names_every_key_of_every_table() -> None:
    sections = _sections()
    rows = sections["Keys above the first table"]
    for entry in msgspec.structs.fields(SwarmConfig):
        key = entry.encode_name
        assert (
            f"| `{key}` |" in rows
            or f"| `[{key}]` |" in rows
            or f"| `[[{key}]]` |" in rows
        ), key
    tables = {f"`[{name}]`": type(value) for name, value in _tables_of(demo_swarm())}
    assert len(tables) > 12
    tables["`[[drones]]`"] = type(demo_swarm().drones[0])
    for heading, kind in tables.items():
        for entry in msgspec.structs.fields(kind):
            row = sections[heading]
            assert f"| `{entry.name}` |" in row or f".{entry.name}]" in row, (
                f"{heading} {entry.name}"
            )


def test_the_reference_shows_the_defaults_of_the_collision_filter() -> None:
    rows = _sections()["`[collision]`"]
    for key, value in msgspec.to_builtins(demo_swarm().collision).items():
        (row,) = [line for line in rows.splitlines() if line.startswith(f"| `{key}` |")]
        assert f"| `{msgspec.json.encode(value).decode()}` |" in row


def _tables_of(config: SwarmConfig) -> list[tuple[str, msgspec.Struct]]:
    """Return the tables of a swarm file with their names."""
    named = [
        (entry.encode_name, getattr(config, entry.name))
        for entry in msgspec.structs.fields(SwarmConfig)
    ]
    return [(name, value) for name, value in named if isinstance(value, msgspec.Struct)]
