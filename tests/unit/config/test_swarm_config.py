"""The swarm file: what it says, round trips, digests, endpoints, the built-in swarms."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import (
    PROCESS_NUMBERS,
    SwarmConfig,
    default_swarm,
    demo_swarm,
    find_swarm,
)
from crazychoir.errors import ConfigError
from crazychoir.radio.budget import compute_setpoint_rates
from crazychoir.team.graph import (
    Graph,
    erdos_renyi_connected,
    graph_from_name,
    path,
    ring,
)

ROOT = Path(__file__).parents[3]

SQUARE = """
name = "square"
seed = 3
{keys}
[[drones]]
id = 0
home = [0, 0, 0]
{first}
[[drones]]
id = 1
home = [1, 0, 0]
[[drones]]
id = 2
home = [1, 1, 0]
[[drones]]
id = 3
home = [0, 1, 0]
{last}
"""


def square(keys: str = "", first: str = "", last: str = "") -> SwarmConfig:
    return SwarmConfig.loads(
        SQUARE.format(keys=keys, first=first, last=last), "square.toml"
    )


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
    assert again.digest() == config.digest()
    assert again.dumps() == config.dumps()
    assert config.replace() == config
    for name in ("name", "mission_options", "seed", "hosts"):
        assert getattr(config, name) == raw[name]


@given(swarms())
def test_processes_cover_the_swarm_and_endpoints_differ(raw: dict[str, object]) -> None:
    config = SwarmConfig.of(raw)
    assert (
        sorted(i for group in config.groups() for i in group)
        == list(config.ids)
        == list(config.graph().ids)
    )
    assert len(dict.fromkeys(config.endpoints().values())) == len(config.groups())


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
    assert config.impairment() == {}
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


def test_neighbors_are_whom_a_drone_hears() -> None:
    raw = tomllib.loads(SQUARE.format(keys="directed = true", first="", last=""))
    for drone, heard in zip(raw["drones"], ([], [0], [1, 0], [2]), strict=True):
        drone["neighbors"] = heard
    graph = SwarmConfig.of(raw).graph()
    assert graph.arcs == ((0, 1), (0, 2), (1, 2), (2, 3))
    assert graph.in_neighbors(2) == (0, 1)


def test_endpoints() -> None:
    assert square().endpoints() == {i: f"tcp/127.0.0.1:{7460 + i}" for i in range(4)}
    shared = square("base_port = 9000\nprocesses = [[3, 1], [0, 2]]")
    assert shared.groups() == ((0, 2), (1, 3))
    assert shared.process(3) == 1
    assert shared.endpoint(3) == "tcp/127.0.0.1:9001"
    assert shared.endpoints() == {0: "tcp/127.0.0.1:9000", 1: "tcp/127.0.0.1:9001"}


@pytest.mark.parametrize(
    ("address", "endpoint"),
    [
        ("10.0.0.7", "tls/10.0.0.7:7460"),
        ("fe80::1", "tls/[fe80::1]:7460"),
        ("lab.local", "tls/lab.local:7460"),
    ],
)
def test_endpoint_of_a_host(address: str, endpoint: str) -> None:
    drones = [{"id": 0, "home": [0, 0, 0], "host": "lab"}]
    raw = {
        "name": "a",
        "hosts": {"lab": address},
        "security": {"operators": ["lab"]},
        "drones": drones,
    }
    assert SwarmConfig.of(raw).endpoint(0) == endpoint


def test_only_lightweight_drones_without_an_owner_are_in_their_agents() -> None:
    assert square().owned == ()
    assert square(first='uri = "sim://motors"').owned == (0,)
    assert square("world.owned = true").owned == (0, 1, 2, 3)
    assert [
        square().source(topic, 2)
        for topic in (
            DRONE_TOPICS.pose,
            DRONE_TOPICS.truth,
            DRONE_TOPICS.body,
            DRONE_TOPICS.state,
        )
    ] == [
        2,
        2,
        2,
        2,
    ]
    owned = square("world.owned = true")
    body = PORT_ADDRESSES.body_offset + 2
    assert [
        owned.source(topic, 2)
        for topic in (
            DRONE_TOPICS.pose,
            DRONE_TOPICS.truth,
            DRONE_TOPICS.body,
            DRONE_TOPICS.state,
        )
    ] == [
        body,
        body,
        body,
        2,
    ]


def test_the_owner_of_the_world_is_reached_before_all_agents() -> None:
    assert list(square("world.owned = true\nbase_port = 9000").endpoints().items())[
        :2
    ] == [
        (PROCESS_NUMBERS.world, "tcp/127.0.0.1:8999"),
        (0, "tcp/127.0.0.1:9000"),
    ]
    raw = {
        "name": "a",
        "hosts": {"lab": "10.0.0.7", "desk": "10.0.0.8"},
        "security": {"operators": ["lab"]},
        "world": {"host": "desk"},
        "drones": [{"id": 0, "home": [0, 0, 0], "host": "lab"}],
    }
    named = SwarmConfig.of(raw)
    assert (named.owned, named.endpoints()[PROCESS_NUMBERS.world]) == (
        (0,),
        "tls/10.0.0.8:7459",
    )


def test_partitions_name_every_drone() -> None:
    config = square(
        last="[[network.partitions]]\nat = 2\ngroups = [[1]]\n[network]\nloss = 0.0\n"
    )
    assert config.impairment() == {
        "loss": 0.0,
        "partitions": [{"at": 2.0, "groups": [[1], [0, 2, 3]]}],
    }
    whole = square(
        last="[[network.partitions]]\nat = 2\nuntil = 3\ngroups = [[1, 0], [2, 3]]\n"
    )
    assert whole.impairment()["partitions"] == [
        {"at": 2.0, "until": 3.0, "groups": [[1, 0], [2, 3]]}
    ]


def test_replace_checks_again() -> None:
    config = square()
    assert config.replace(graph="path", seed=8).graph() == path(4)
    assert config.replace(network={"loss": 0.3}).impairment() == {"loss": 0.3}
    assert config.replace(
        drones=[msgspec.structs.replace(config.drone(2), id=9)]
    ).ids == (9,)
    assert config.replace(processes=[[0, 1, 2, 3]]).replace(processes=None) == config
    with pytest.raises(ConfigError, match=r"^swarm square: start: found 5; allowed"):
        config.replace(start=5)
    with pytest.raises(ConfigError, match="Did you mean graph"):
        config.replace(grap="ring")


def test_digest_counts_what_hosts_must_agree_on() -> None:
    config = square('mission = "formation"')
    same = [
        config.replace(base_port=9000),
        config.replace(network={"loss": 0.5}),
        SwarmConfig.loads(config.dumps()),
        config.replace(seed=3, lost_after=5.0),
    ]
    other = [
        config.replace(seed=4),
        config.replace(graph="path"),
        config.replace(mission="bearing"),
        config.replace(mission_options={"kp": 2}),
        config.replace(drones=config.drones[:3]),
        config.replace(flight={"speed_limit": 0.5}),
    ]
    assert [one.digest() for one in same] == [config.digest()] * len(same)
    assert (
        len(dict.fromkeys(one.digest() for one in [config, *other])) == len(other) + 1
    )
    folders = [
        config.replace(mission=f"/{folder}/own.py") for folder in ("home/a", "srv")
    ]
    assert folders[0].digest() == folders[1].digest()


def test_digest_does_not_depend_on_the_order_of_free_keys_or_the_hash_seed() -> None:
    forward, backward = (
        square().replace(mission_options=o)
        for o in ({"a": 1, "b": 2}, {"b": 2, "a": 1})
    )
    assert forward.digest() == backward.digest()
    program = "from crazychoir.config.swarm_config import demo_swarm; print(demo_swarm().digest())"
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        said = subprocess.run(
            [sys.executable, "-c", program],
            env=environment,
            capture_output=True,
            check=True,
            cwd=ROOT,
        )
        assert said.stdout.decode().strip() == demo_swarm().digest()


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


def test_a_mission_path_is_relative_to_the_swarm_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lab").mkdir()
    file = tmp_path / "lab" / "own.toml"
    file.write_text(SQUARE.format(keys='mission = "../own.py"', first="", last=""))
    config = SwarmConfig.load(file)
    assert config.mission == str(tmp_path / "own.py")
    (tmp_path / "child.json").write_text(config.dumps())
    assert SwarmConfig.load(tmp_path / "child.json") == config
    monkeypatch.chdir(tmp_path)
    assert default_swarm(1).replace(mission="here.py").mission == str(
        tmp_path / "here.py"
    )


@pytest.mark.parametrize(
    "file", ["lab6.toml", "two_hosts.toml", "mujoco30.toml", "virtual4.toml"]
)
def test_the_examples_of_deploy_load(file: str) -> None:
    config = SwarmConfig.load(ROOT / "deploy" / file)
    assert config.name == Path(file).stem
    assert config.graph().is_connected
    assert (
        len(config.drones)
        == {"lab6": 6, "two_hosts": 4, "mujoco30": 30, "virtual4": 4}[config.name]
    )
    assert SwarmConfig.loads(config.dumps()) == config


def test_dongles_carry_the_six_of_the_laboratory_if_their_uris_say_so() -> None:
    text = (ROOT / "deploy" / "lab6.toml").read_text()
    config = SwarmConfig.loads(
        re.sub(r"id = (\d)", r'id = \1\nuri = "udp://127.0.0.1:1985\1"', text),
        "lab6.toml",
    )
    assert compute_setpoint_rates(config) == {0: 84.0, 1: 84.0, 2: 84.0}


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
            assert f"| `{entry.name}` |" in row or f".{entry.name}]]` |" in row, (
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


def test_files_of_options_are_relative_to_the_swarm_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lab").mkdir()
    text = (
        square()
        .replace(
            mission_options={
                "instance": "../own.json",
                "drawing": "a.csv",
                "method": "x",
            }
        )
        .dumps()
    )
    (tmp_path / "lab" / "own.json").write_text(text)
    monkeypatch.chdir("/")
    config = SwarmConfig.load(tmp_path / "lab" / "own.json")
    found = {
        "instance": str(tmp_path / "own.json"),
        "drawing": str(tmp_path / "lab" / "a.csv"),
        "method": "x",
    }
    assert config.mission_options == found
    assert SwarmConfig.loads(config.dumps()) == config


@pytest.mark.parametrize("key", ["drawing", "instance", "uri"])
def test_a_file_name_that_is_not_text_reaches_another_process(
    tmp_path: Path, key: str
) -> None:
    folder = tmp_path / "l\udce4b"
    folder.mkdir()
    uri = "replay://a.csv" if key == "uri" else "sim://"
    drones = [{"id": 0, "home": [0, 0, 0], "uri": uri}, {"id": 1, "home": [1, 0, 0]}]
    options = {} if key == "uri" else {key: "a.csv"}
    (folder / "own.json").write_text(
        square().replace(drones=drones, graph="path", mission_options=options).dumps()
    )
    config = SwarmConfig.load(folder / "own.json")
    assert config.files
    handed_over = config.dumps()
    assert handed_over.isascii()
    assert SwarmConfig.loads(handed_over) == config


def test_a_name_that_no_file_can_have_is_refused_with_its_key(tmp_path: Path) -> None:
    for key, changes in (
        ("mission_options.drawing", {}),
        ("drone 0: uri", {"uri": "replay://a\0b.csv"}),
    ):
        drones = [{"id": 0, "home": [0, 0, 0], **changes}]
        options = {} if changes else {"drawing": "a\0b.csv"}
        raw = {
            "name": "one",
            "drones": drones,
            "graph": "empty",
            "mission_options": options,
        }
        (tmp_path / "own.json").write_text(json.dumps(raw))
        with pytest.raises(ConfigError, match=rf"^{key}: found 'a\\x00b.csv'"):
            SwarmConfig.load(tmp_path / "own.json")


def test_a_file_is_found_by_a_name_that_the_locale_cannot_say(tmp_path: Path) -> None:
    raw = {"name": "one", "drones": [{"id": 0, "home": [0, 0, 0]}], "graph": "empty"}
    (tmp_path / "own.json").write_text(
        json.dumps(raw | {"mission_options": {"drawing": "h\xf6rz.csv"}})
    )
    (tmp_path / "h\xf6rz.csv").write_text("0,0,1")
    load = "import sys; from crazychoir import SwarmConfig; config = SwarmConfig.load(sys.argv[1])"
    code = f"{load}; print(*(path.exists() for path in config.files.values()))"
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-c", code, str(tmp_path / "own.json")]
    done = subprocess.run(
        command,
        env=os.environ | ascii_only,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "True\n", done.stderr


def test_recordings_that_drones_replay_are_relative_to_the_swarm_file_and_count_by_content(
    tmp_path: Path,
) -> None:
    drones = [
        {"id": 0, "home": [0, 0, 0], "uri": "replay://../a.csv?drone=2"},
        {"id": 1, "home": [1, 0, 0]},
    ]
    for lab in ("here", "there"):
        (tmp_path / lab / "lab").mkdir(parents=True)
        (tmp_path / lab / "a.csv").write_text("t,x,y,z,yaw")
        text = square().replace(drones=drones, graph="path").dumps()
        (tmp_path / lab / "lab" / "own.json").write_text(text)
    here, there = (
        SwarmConfig.load(tmp_path / lab / "lab" / "own.json")
        for lab in ("here", "there")
    )
    assert here.drone(0).uri == f"replay://{tmp_path / 'here' / 'a.csv'}?drone=2"
    assert here.drone(1).uri == "sim://"
    assert here.digest() == there.digest()
    (tmp_path / "there" / "a.csv").write_text("x,y")
    assert here.digest() != there.digest()
    assert SwarmConfig.loads(here.dumps()) == here
