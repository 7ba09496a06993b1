"""Every rule of a swarm file, broken once: the text says where, what was found, what is allowed, what to do."""

from pathlib import Path
from typing import Annotated, get_args, get_origin

import msgspec
import pytest

from crazychoir.config import tables
from crazychoir.config.addresses import Addresses
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import ConfigError

FLOWN = "sim://, sim://single, sim://double, sim://unicycle, sim://motors, mujoco://, replay://FILE"
LINKS = "udp://HOST:PORT, radio://DONGLE/CHANNEL/RATE/ADDRESS"
CASES = {
    "unknown key": (
        'colour = "red"',
        "",
        'x.toml: colour = "red": there is no such key; the keys here are name, drones, defaults, left_out, mission, '
        "mission_options, seed, graph, edges, directed, start, start_deadline, lost_after, lease, base_port, "
        "processes, hosts, router, security, network, flight, fence, keep_out, mocap, radio, plant, motors, "
        "mujoco, world, collision, control, roles, logs. Remove it; write your own keys into [mission_options].",
    ),
    "misspelt key of a drone": (
        "",
        "neighbours = [2]",
        "x.toml: drones[3].neighbours = [2]: there is no such key; the keys here are id, home, name, enabled, "
        "neighbors, body, calibration, uri, platform, yaw, leader, role, host, options, dongle, pose, body_offset, "
        "body_rotation, parameters, battery_warning, battery_critical. Did you mean neighbors?",
    ),
    "unknown key beside one that is missing": (
        "network.partitions = [{ groups = [[0]], since = 8.0 }]",
        "",
        "x.toml: network.partitions[0].since = 8.0: there is no such key; the keys here are at, groups, until. "
        "Remove it; write your own keys into [mission_options].",
    ),
    "wrong type": (
        "seed = 1.5",
        "",
        "x.toml: seed: found 1.5; allowed: a whole number, not negative. For example seed = 1.",
    ),
    "number for a flag": (
        "directed = 1",
        "",
        "x.toml: directed: found 1; allowed: true or false. For example directed = true.",
    ),
    "not a table": (
        "flight = 3",
        "",
        "x.toml: flight: found 3; allowed: a table with ground, takeoff_height, speed_limit, acceleration_limit, "
        "landing_speed, operator, dead_man.",
    ),
    "out of range in a table": (
        "network = { loss = 1.5 }",
        "",
        "x.toml: network.loss: found 1.5; allowed: a probability, 0 to 1. For example loss = 0.1.",
    ),
    "a console that cannot be in time": (
        "flight.dead_man = 0.5",
        "",
        "x.toml: flight.dead_man: found 0.5; allowed: 0 (never), or 2 s and more: a console speaks twice a second, and "
        "one word may be lost. Raise it: all would land at once.",
    ),
    "choice": (
        'plant.inputs = "pwm"',
        "",
        'x.toml: plant.inputs: found "pwm"; allowed: the commands that steer it: "rates" (of the body) or "euler" '
        '(of the Euler angles). For example inputs = "rates".',
    ),
    "infinity": (
        "lease = inf",
        "",
        "x.toml: lease: found Infinity; allowed: finite numbers below 2^63, texts, true, false.",
    ),
    "date in a free table": (
        "mission_options.day = 2025-01-31",
        "",
        'x.toml: mission_options.day: found "2025-01-31"; allowed: finite numbers below 2^63, texts, true, false.',
    ),
    "too deep": (
        "mission_options.a = [[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]",
        "",
        "x.toml: mission_options.a[0][0][0][0][0][0][0][0][0][0][0][0][0][0][0]: found a deeper nest; "
        "allowed: 16 levels of lists and tables.",
    ),
    "mission": (
        'mission = "My Mission"',
        "",
        'x.toml: mission: found "My Mission"; allowed: the name of a file in agents/, or the path of a .py file. '
        'For example mission = "pickup_delivery".',
    ),
    "unknown neighbour": (
        "",
        "neighbors = [2, 7]",
        "x.toml: drones[3].neighbors = [2, 7]: there is no drone 7; this swarm has 0 to 3. "
        "Add a [[drones]] with id = 7, or correct the list.",
    ),
    "own neighbour": (
        "",
        "neighbors = [3]",
        "x.toml: drones[3].neighbors = [3]: the drone itself; a neighbour is another one. Remove it.",
    ),
    "one-sided neighbours": (
        "",
        "neighbors = [2, 0]",
        "x.toml: drones[3].neighbors = [2, 0]: drone 2 does not list drone 3; neighbours of an undirected graph list "
        "each other. Add 3 to drones[2].neighbors, or set directed = true.",
    ),
    "a graph that is never directed": (
        'graph = "path"\ndirected = true',
        "",
        "x.toml: graph: found path with directed = true; allowed: ring, erdos-renyi:P. Name one of these, list `edges` "
        "or the drones' `neighbors`, or leave directed out.",
    ),
    "two graphs": (
        'graph = "ring"\nedges = [[0, 1]]',
        "",
        "x.toml: graph: found graph and edges; allowed: one of graph, edges, neighbors. Remove the others.",
    ),
    "graph name": (
        'graph = "rng"',
        "",
        "x.toml: graph: found rng; allowed: ring, path, star, complete, empty, k-regular:K, erdos-renyi:P, "
        "geometric:R, grid:ROWSxCOLUMNS. Did you mean ring?",
    ),
    "graph that cannot be": (
        'graph = "k-regular:4"',
        "",
        "x.toml: graph: found k = 4; allowed: 0 to 3, with k times 4 drones even.",
    ),
    "edge to nobody": (
        "edges = [[0, 1], [0, 9]]",
        "",
        "x.toml: edges[1] = [0, 9]: there is no drone 9; this swarm has 0 to 3. "
        "Add a [[drones]] with id = 9, or correct the list.",
    ),
    "loop": (
        "edges = [[2, 2]]",
        "",
        "x.toml: edges[0] = [2, 2]: a loop; an edge joins two drones. Remove it.",
    ),
    "same id": (
        "",
        "[[drones]]\nid = 1\nhome = [2, 2, 0]",
        "x.toml: drones[4].id = 1: drones[1] has this id; each id is there once. Give it another id.",
    ),
    "no home": (
        "",
        "[[drones]]\nid = 8",
        "x.toml: drones[4].home: found nothing; allowed: a position [x, y, z] in m. "
        "Add for example home = [0.0, 0.6, 0.0].",
    ),
    "unknown uri": (
        "",
        'uri = "simulation"',
        f'x.toml: drones[3].uri: found "simulation"; allowed: {FLOWN}, {LINKS}. Write uri = "sim://", or leave it '
        "out.",
    ),
    "unknown scheme": (
        "",
        'uri = "gazebo://hall"',
        f'x.toml: drones[3].uri: found "gazebo://hall"; allowed: {FLOWN}, {LINKS}. Write uri = "sim://", or install '
        "a package with the entry point gazebo in crazychoir.worlds.",
    ),
    "mistyped scheme": (
        "",
        'uri = "radoi://0/80/2M/E7E7E7E703"',
        f'x.toml: drones[3].uri: found "radoi://0/80/2M/E7E7E7E703"; allowed: {FLOWN}, {LINKS}. Write uri = '
        '"radio://DONGLE/CHANNEL/RATE/ADDRESS", or install a package with the entry point radoi in crazychoir.worlds.',
    ),
    "unknown world of ours": (
        "",
        'uri = "sim://motor"',
        f'x.toml: drones[3].uri: found "sim://motor"; allowed: {FLOWN}, {LINKS}. Write uri = "sim://", or leave it '
        "out.",
    ),
    "faster than the planner on board": (
        '[flight]\nspeed_limit = 2.0\n[control]\nsender = "xyz"',
        "",
        "x.toml: flight.speed_limit = 2.0: drone 0 is sent places (xyz), which the firmware flies to at 1 m/s; "
        "at most 1 m/s with xyz. Lower it, or choose another sender.",
    ),
    "unknown platform": (
        "",
        'platform = "cf22"',
        "x.toml: drones[3].platform: found cf22; allowed: one of paper, cf21, cf21plus, cf21thrust, cf21bl.",
    ),
    "delay within a step": (
        "plant.command_delay = 0.013",
        'uri = "sim://motors"',
        "x.toml: plant.command_delay: found 0.013; allowed: multiples of 0.01 s, a step of the world, unless all "
        "drones are sim://. For example 0.01.",
    ),
    "world on no host": (
        'world.host = "desk"',
        "",
        'x.toml: world.host = "desk": there is no such host; [hosts] has none, there is no [hosts]. Correct the name.',
    ),
    "no port for the world": (
        "base_port = 1024\nworld.owned = true",
        "",
        "x.toml: base_port = 1024: routers, owners of worlds and radios listen down to base_port - 1; ports begin at "
        "1024. Raise it.",
    ),
    "a router nowhere": (
        'router = "desk"',
        "",
        'x.toml: router = "desk": there is no such host; [hosts] has none, there is no [hosts]. Correct the name, or '
        "leave router out: hosts then reach each other directly.",
    ),
    "outside the fence": (
        "fence.max = [4, 0.9, 3]",
        "",
        "x.toml: drones[2].home = [1.0, 1.0, 0.0]: outside the fence; [fence] goes from "
        "[-4.0, -4.0, 0.0] to [4.0, 0.9, 3.0]. Move the drone, or widen [fence].",
    ),
    "limit area at the fence": (
        "keep_out.max = [4.5, 4.2, 3.5]",
        "",
        "x.toml: keep_out = [-4.5, -4.5, -0.5] to [4.5, 4.2, 3.5]: 0.2 m from a side of the fence; 0.3 m or more "
        "around [fence], which goes from [-4.0, -4.0, 0.0] to [4.0, 4.0, 3.0]. "
        "Widen it, shrink [fence], or leave [keep_out] out: 0.5 m around the fence.",
    ),
    "limit area above the floor": (
        "keep_out.min = [-5, -5, 0.1]",
        "",
        "x.toml: keep_out = [-5.0, -5.0, 0.1] to [4.5, 4.5, 3.5]: its floor is above the fence's; 0.3 m or more around "
        "[fence], which goes from [-4.0, -4.0, 0.0] to [4.0, 4.0, 3.0]. "
        "Widen it, shrink [fence], or leave [keep_out] out: 0.5 m around the fence.",
    ),
    "fence upside down": (
        "fence.min = [0, 5, 0]",
        "",
        "x.toml: fence: found [0.0, 5.0, 0.0] to [4.0, 4.0, 3.0]; allowed: max above min in x, y and z. Exchange them.",
    ),
    "fence without room": (
        "fence.max = [4, 4, 0.1]\nflight.takeoff_height = 0.05",
        "",
        "x.toml: fence = [-4.0, -4.0, 0.0] to [4.0, 4.0, 0.1]: no room is left inside it in which a drone may be sent; "
        "a box of more than 0.01 m aside, and more than 0.105 m above flight.ground. Widen it.",
    ),
    "take-off through the roof": (
        "flight.takeoff_height = 3.5",
        "",
        "x.toml: flight.takeoff_height = 3.5: above flight.ground it ends at 3.5 m, outside the fence; "
        "[fence] goes from 0 to 3 m. Lower it, or raise fence.max.",
    ),
    "homes that touch": (
        "",
        "[[drones]]\nid = 8\nhome = [0.05, 0, 0]",
        "x.toml: drones[0].home = [0.0, 0.0, 0.0]: 0.05 m from the home of drone 8; homes are 0.137 m apart or more. "
        "Move one of them.",
    ),
    "cameras that are late": (
        "mocap.latency = 0.1",
        "",
        "x.toml: mocap = latency 0.1 s, rate 100 Hz: poses get 0.11 s old before the next one comes; "
        "at most 0.1 s: a drone with an older pose brakes. Lower the latency, or raise the rate.",
    ),
    "cameras that are late by a part of a period": (
        "mocap.latency = 0.015",
        "",
        "x.toml: mocap.latency: found 0.015; allowed: multiples of 0.01 s, 1 / rate.",
    ),
    "cameras that are slow": (
        "mocap.rate = 8",
        "",
        "x.toml: mocap = latency 0 s, rate 8 Hz: poses get 0.125 s old before the next one comes; "
        "at most 0.1 s: a drone with an older pose brakes. Lower the latency, or raise the rate.",
    ),
    "host without a table": (
        "",
        'host = "lab"',
        'x.toml: drones[3].host = "lab": there is no such host; [hosts] has none, there is no [hosts]. '
        'Add lab = "its address" to [hosts], or correct the name.',
    ),
    "drone without a host": (
        'hosts.lab = "10.0.0.1"',
        "",
        'x.toml: drones[0].host: found nothing; allowed: a name of [hosts]: lab. Add host = "lab".',
    ),
    "address with a port": (
        'hosts.lab = "10.0.0.1:7447"',
        "",
        'x.toml: hosts.lab: found "10.0.0.1:7447"; allowed: an IP address or a DNS name. '
        "Leave out the port: ports come from base_port.",
    ),
    "address that is none": (
        'hosts.lab = "10.0.0.999"',
        "",
        'x.toml: hosts.lab: found "10.0.0.999"; allowed: an IP address or a DNS name. Write an IP address '
        "or a DNS name, as 10.0.0.2 or lab-3.local: letters a to z, digits, hyphens and dots.",
    ),
    "name of a host": (
        'hosts."Lab 1" = "10.0.0.1"',
        "",
        'x.toml: hosts.Lab 1: found "Lab 1"; allowed: names of 1 to 40 of a-z, 0-9, _ and -. Rename it.',
    ),
    "process of nobody": (
        "processes = [[0, 1], [2, 3, 4]]",
        "",
        "x.toml: processes[1] = [2, 3, 4]: there is no drone 4; this swarm has 0 to 3. "
        "Add a [[drones]] with id = 4, or correct the list.",
    ),
    "drone in no process": (
        "processes = [[0, 1], [2]]",
        "",
        "x.toml: processes = [[0, 1], [2]]: drone 3 is there 0 times; each drone is in one process. "
        "Correct it, or leave processes out: one process a drone.",
    ),
    "empty process": (
        "processes = [[0, 1, 2, 3], []]",
        "",
        "x.toml: processes: found [[0, 1, 2, 3], []]; allowed: lists of drone ids, none of them empty. "
        "For example processes = [[0, 1], [2, 3]].",
    ),
    "start with more than there are": (
        "start = 5",
        "",
        'x.toml: start: found 5; allowed: "all", or 1 to 4 drones. Lower it, or add drones.',
    ),
    "ports that end": (
        "base_port = 65533",
        "",
        "x.toml: base_port = 65533: a process listens on base_port + its lowest drone id, here up to 65536; "
        "ports end at 65535. Lower it.",
    ),
    "link of nobody": (
        "",
        "[[network.edges]]\nsource = 0\ndestination = 6",
        "x.toml: network.edges[0] = [0, 6]: there is no drone 6; this swarm has 0 to 3. "
        "Add a [[drones]] with id = 6, or correct the list.",
    ),
    "burst without a loss": (
        "",
        "[[network.edges]]\nsource = 0\nburst = 3",
        "x.toml: network.edges[0].burst = 3.0: no loss is given; "
        "a burst has 1 / (1 - loss) messages or more. Correct loss (0 for none), or remove burst.",
    ),
    "burst too short for its loss": (
        "",
        "[network]\nloss = 0.9\nburst = 3",
        "x.toml: network.burst = 3.0: too short for loss = 0.9; "
        "a burst has 1 / (1 - loss) messages or more. Correct loss (0 for none), or remove burst.",
    ),
    "link without ends": (
        "",
        "[[network.edges]]\nloss = 0.5",
        "x.toml: network.edges[0]: found neither source nor destination; allowed: one or both. "
        "A rule for all goes into [network].",
    ),
    "partition of nobody": (
        "",
        "[[network.partitions]]\nat = 1\ngroups = [[0], [5]]",
        "x.toml: network.partitions[0].groups = [5]: there is no drone 5; this swarm has 0 to 3. "
        "Add a [[drones]] with id = 5, or correct the list.",
    ),
    "partition that ends before": (
        "",
        "[[network.partitions]]\nat = 5\nuntil = 5\ngroups = [[0]]",
        "x.toml: network.partitions[0].until: found 5.0; allowed: later than at = 5. Leave it out: it never heals.",
    ),
    "groups that overlap": (
        "",
        "[[network.partitions]]\nat = 5\ngroups = [[0, 1], [1, 2]]",
        "x.toml: network.partitions[0].groups = [[0, 1], [1, 2]]: drone 1 is in two groups; groups are disjoint. "
        "Correct the groups.",
    ),
}


def swarm_text(keys: str, last: str) -> str:
    """Four drones in a square; those before the last get neighbours when it has some."""
    homes = ([0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0])
    rest = "neighbors = []\n" if "neighbors" in last else ""
    drones = "\n".join(
        f"[[drones]]\nid = {i}\nhome = {home}\n{rest if i < 3 else ''}"
        for i, home in enumerate(homes)
    )
    return f'name = "x"\n{keys}\n{drones}\n{last}\n'


@pytest.mark.parametrize("case", CASES)
def test_error_text(case: str) -> None:
    keys, last, text = CASES[case]
    with pytest.raises(ConfigError) as caught:
        SwarmConfig.loads(swarm_text(keys, last), "x.toml")
    assert str(caught.value) == text


def test_the_square_itself_is_right() -> None:
    assert SwarmConfig.loads(swarm_text("", ""), "x.toml").ids == (0, 1, 2, 3)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (
            "a = [",
            "x.toml: found Invalid value (at line 1); allowed: TOML text. Correct the line.",
        ),
        (
            "name = 'x'\na = [\n  1",
            "x.toml: found Unclosed array (at line 2); allowed: TOML text. Correct the line.",
        ),
        (
            '{"name": ',
            "x.toml: found Input data was truncated; allowed: JSON text. Correct the line.",
        ),
        (
            'name = "x"\ndrones = []',
            "x.toml: drones: found no drone; allowed: one or more. Add a [[drones]].",
        ),
        (
            '{"name": "x"}',
            "x.toml: drones: found nothing; allowed: a list of drones: one table [[drones]] each. ",
        ),
        (
            'name = "x"\ndrones = [3]',
            "x.toml: drones[0]: found 3; allowed: a table with id, home, name",
        ),
        (
            'name = "x"\ndrones = 3',
            "x.toml: drones: found 3; allowed: a list of drones",
        ),
        (
            "drones = []",
            'x.toml: name: found nothing; allowed: 1 to 40 of a-z, 0-9, _ and -. Add for example name = "',
        ),
        (
            'name = "X\\n"\ndrones = []',
            'x.toml: name: found "X\\n"; allowed: 1 to 40 of a-z',
        ),
    ],
)
def test_broken_texts(text: str, error: str) -> None:
    with pytest.raises(ConfigError) as caught:
        SwarmConfig.loads(text, "x.toml")
    assert str(caught.value).startswith(error)


def test_neighbors_of_some_only() -> None:
    raw = msgspec.to_builtins(default_swarm(3).replace(graph=None))
    raw["drones"][0]["neighbors"] = []
    with pytest.raises(ConfigError) as caught:
        SwarmConfig.of(raw, "x.toml")
    assert str(caught.value) == (
        "x.toml: drones[1].neighbors: found nothing; allowed: a list, as the other drones have one. "
        "For none, neighbors = []."
    )


def test_a_process_on_two_hosts() -> None:
    hosts = {"a": "10.0.0.1", "b": "10.0.0.2"}
    drones = [
        {"id": i, "home": [i, 0, 0], "host": host} for i, host in enumerate(hosts)
    ]
    with pytest.raises(ConfigError) as caught:
        SwarmConfig.of(
            {"name": "x", "hosts": hosts, "drones": drones, "processes": [[0, 1]]},
            "x.toml",
        )
    assert str(caught.value) == (
        "x.toml: processes[0] = [0, 1]: drones of several hosts; a process is on one host. Split it."
    )


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for path, reason in (
        (tmp_path / "none.toml", "no file (No such file or directory)"),
        (tmp_path, "a file that cannot be read (Is a directory)"),
    ):
        with pytest.raises(ConfigError) as caught:
            SwarmConfig.load(path)
        assert str(caught.value) == (
            f"{path}: found {reason}; allowed: a swarm file, TOML or JSON. "
            'A minimal file has name = "lab" and a table [[drones]] with id = 0 and home = [0, 0, 0] for each drone.'
        )
    (tmp_path / "bytes.toml").write_bytes(b"name = '\xff'")
    with pytest.raises(ConfigError, match="found bytes that are not UTF-8"):
        SwarmConfig.load(tmp_path / "bytes.toml")


def test_a_request_for_an_unknown_drone_is_refused() -> None:
    for wrong in (
        default_swarm(3).drone,
        Addresses(default_swarm(3)).endpoint,
        Addresses(default_swarm(3)).process,
    ):
        with pytest.raises(
            ConfigError, match=r"^swarm default: found drone 9; allowed: 0 to 2\.$"
        ):
            wrong(9)
    with pytest.raises(ConfigError, match="found no drone"):
        default_swarm(0)


def test_hostile_depth_is_a_config_error() -> None:
    for text in ("a = " + "[" * 50_000, '{"a":' * 50_000, "a" + ".a" * 5_000 + " = 1"):
        with pytest.raises(ConfigError):
            SwarmConfig.loads(text)


def test_every_key_says_what_is_allowed_and_its_example_is() -> None:
    structs = [
        kind
        for kind in vars(tables).values()
        if isinstance(kind, type) and issubclass(kind, tables.SwarmTable)
    ]
    assert len(structs) == 24
    for kind in structs:
        for entry in msgspec.structs.fields(kind):
            said = next(
                (
                    t
                    for t in (entry.type, *get_args(entry.type))
                    if get_origin(t) is Annotated
                ),
                None,
            )
            if said is None:
                assert issubclass(entry.type, tables.SwarmTable), entry.name
                continue
            meta = said.__metadata__[0]
            assert meta.description, entry.name
            assert msgspec.convert(meta.examples[0], said) is not None
