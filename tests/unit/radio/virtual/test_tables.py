"""The tables of contents of virtual drones against the table of a build of the firmware."""

import struct
from dataclasses import dataclass
from pathlib import Path

import pytest
from virtual_drones import Hangar

from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.radio.virtual.toc import read_firmware_names

LOG_TYPE_NUMBERS = {
    "uint8_t": 1,
    "uint16_t": 2,
    "uint32_t": 3,
    "int8_t": 4,
    "int16_t": 5,
    "int32_t": 6,
    "float": 7,
}
PARAMETER_TYPES = {
    "uint8_t": (0x08, "B"),
    "uint16_t": (0x09, "H"),
    "uint32_t": (0x0A, "I"),
    "int8_t": (0x00, "b"),
    "int16_t": (0x01, "h"),
    "int32_t": (0x02, "i"),
    "float": (0x06, "f"),
}
FACTS = Path("tests/data/crazyflie_toc.txt")
DEFAULTS = {"stabilizer.controller": "0", "stabilizer.estimator": "0"}
"""Default values that are not those after a start: 0 lets the firmware choose."""
FLOW_DECK_GROUPS = ("deck", "motion")
"""Groups of entries of decks that a drone with a flow deck has."""


@dataclass(frozen=True)
class Fact:
    """An entry of the firmware's tables."""

    name: str
    kind: str
    boot: str
    is_read_only: bool
    is_persistent: bool
    needs_deck: bool


CFCLIENT_BLOCKS = {
    "attitude": ("controller", "pitch roll yaw", "stateEstimate", "pitch roll yaw"),
    "attitude rate": ("controller", "pitchRate rollRate yawRate", "gyro", "x y z"),
    "position": ("posCtl", "targetX targetY targetZ", "stateEstimate", "x y z"),
    "velocity": ("posCtl", "targetVX targetVY targetVZ", "stateEstimate", "vx vy vz"),
    "stabilizer": ("stabilizer", "roll pitch yaw thrust", "motor", "m1 m2 m3 m4"),
    "sensors": ("mag", "x y z", "baro", "asl pressure temp"),
}
"""Log blocks of cfclient (src/cfclient/configs/log): two groups with names."""


def parse_fact(group, item):
    """Return the entry of a text such as "roll_kp:float+=6.0"."""
    name, _, rest = item.rstrip("!").partition(":")
    kind, _, boot = rest.partition("=")
    return Fact(
        f"{group}.{name}",
        kind.rstrip("*+"),
        boot,
        "*" in kind,
        "+" in kind,
        item.endswith("!"),
    )


def read_facts(repository, table, has_decks=True):
    """Return the entries of a table, "L" or "P", of the build."""
    found = []
    for line in (repository / FACTS).read_text(encoding="utf-8").splitlines():
        which, group, *items = line.split()
        if which == table:
            found += [parse_fact(group, item) for item in items]
    return [fact for fact in found if has_decks or not fact.needs_deck]


def select_facts(repository, table, decks):
    """Return the entries of a drone without decks, or with a flow deck."""
    return [
        fact
        for fact in read_facts(repository, table)
        if not fact.needs_deck
        or (decks and fact.name.split(".")[0] in FLOW_DECK_GROUPS)
    ]


def fetch_table(drone, port):
    """Return the entries of a table, fetched by packets: {name: (index, type)}."""
    (info,) = drone.take(Packet(port, 0, b"\x03"))
    found = {}
    for k in range(int.from_bytes(info.data[1:3], "little")):
        (item,) = drone.take(Packet(port, 0, b"\x02" + k.to_bytes(2, "little")))
        group, name, _ = item.data[4:].split(b"\0")
        found[f"{group.decode()}.{name.decode()}"] = (k, item.data[3])
    return found


def ask(drone, channel, *data):
    """Return the data of the answer of the port of parameters."""
    (answer,) = drone.take(Packet(CrtpPort.PARAMETERS, channel, b"".join(data)))
    return answer.data


def test_the_table_of_the_package_is_that_of_the_build(repository):
    for table, entries in zip("LP", read_firmware_names(), strict=True):
        facts = {fact.name: fact for fact in read_facts(repository, table)}
        assert sorted(facts) == sorted(entry.full for entry in entries)
        for entry in entries:
            fact = facts[entry.full]
            assert (entry.kind, entry.read_only) == (fact.kind, fact.is_read_only)
            assert (entry.deck != "") == fact.needs_deck, entry.full
            if not fact.needs_deck:
                assert entry.persistent == fact.is_persistent, entry.full
    sizes = [
        len(read_facts(repository, table, has_decks))
        for table in "LP"
        for has_decks in (False, True)
    ]
    assert sizes == [434, 567, 271, 335]


@pytest.mark.parametrize("decks", [(), ("bcFlow2",)])
def test_a_drone_serves_the_log_variables_of_its_decks_with_their_types(
    repository, decks
):
    hangar = Hangar(decks=decks)
    expected = {
        fact.name: LOG_TYPE_NUMBERS[fact.kind]
        for fact in select_facts(repository, "L", decks)
    }
    found = fetch_table(hangar.drone, CrtpPort.LOG)
    assert {name: kind for name, (_, kind) in found.items()} == expected
    assert len(found) == (444 if decks else 434)


@pytest.mark.parametrize("decks", [(), ("bcFlow2",)])
def test_a_drone_serves_the_parameters_of_its_decks_with_type_and_access(
    repository, decks
):
    hangar = Hangar(decks=decks)
    expected = {
        fact.name: PARAMETER_TYPES[fact.kind][0]
        | 0x40 * fact.is_read_only
        | 0x10 * (fact.is_persistent or fact.name == "motion.flowStdFixed")
        for fact in select_facts(repository, "P", decks)
    }
    found = fetch_table(hangar.drone, CrtpPort.PARAMETERS)
    assert {name: kind for name, (_, kind) in found.items()} == expected
    assert len(found) == (271 + 18 + 3 if decks else 271)


def test_each_parameter_boots_and_defaults_as_in_the_firmware(repository):
    drone = Hangar().run(0.5).drone
    found = fetch_table(drone, CrtpPort.PARAMETERS)
    for fact in read_facts(repository, "P", has_decks=False):
        index = found[fact.name][0].to_bytes(2, "little")
        letter = PARAMETER_TYPES[fact.kind][1]
        # the model of the firmware has the mass and gains as rounded decimals
        (value,) = struct.unpack("<" + letter, ask(drone, 1, index)[3:])
        assert value == pytest.approx(float(fact.boot), rel=1e-6), fact
        answer = ask(drone, 3, b"\x08", index)[3:]
        if fact.is_read_only:
            assert answer == b"\x02", fact
        else:
            default = float(DEFAULTS.get(fact.name, fact.boot))
            number = default if letter == "f" else int(default)
            assert answer == b"\0" + struct.pack("<" + letter, number), fact


def test_the_flags_of_decks_are_there_with_any_deck_and_tell_which_it_is():
    drone = Hangar(decks=("bcFlow2",)).drone
    assert drone.parameters.read("deck.bcFlow2") == 1.0
    assert drone.parameters.read("deck.bcLedRing") == 0.0


def test_what_nothing_computes_is_logged_as_0():
    hangar = Hangar().run(0.1)
    assert hangar.log("mag.x") == 0.0
    assert hangar.log("tdoaEngine.stRx") == 0.0


def test_drones_with_the_same_decks_share_their_tables():
    first = Hangar().drone
    second = Hangar().drone
    assert first.logs.toc is second.logs.toc
    assert first.parameters.toc is second.parameters.toc
    second.parameters.set("led.bitmask", 3.0)
    assert first.parameters.read("led.bitmask") == 0.0


def test_each_parameter_has_a_state_and_only_persistent_ones_an_extended_type(
    repository,
):
    drone = Hangar().drone
    found = fetch_table(drone, CrtpPort.PARAMETERS)
    for fact in read_facts(repository, "P", has_decks=False):
        name = fact.name
        index = found[name][0].to_bytes(2, "little")
        size = struct.calcsize(PARAMETER_TYPES[fact.kind][1])
        state = ask(drone, 3, b"\x04", index)[3:]
        assert (state[:1], len(state)) == (b"\0", 1 + size), name
        extended = ask(drone, 3, b"\x07", index)[3:]
        assert extended == (b"\0\1" if fact.is_persistent else b"\2"), name
        assert ask(drone, 3, b"\x02", index)[3:] == extended[-1:], name
        stored = ask(drone, 3, b"\x03", index)[3:]
        assert stored == (b"\0" if fact.is_persistent else b"\2"), name


@pytest.mark.parametrize("name", ["pid_rate.roll_kp", "colAv.horizon"])
def test_a_parameter_that_is_no_number_is_stored(name):
    drone = Hangar().drone
    index = drone.parameters.toc.index[name].to_bytes(2, "little")
    nothing = struct.pack("<f", float("nan"))
    list(drone.take(Packet(CrtpPort.PARAMETERS, 2, index + nothing)))
    assert ask(drone, 1, index)[3:] == nothing


@pytest.mark.parametrize("block", CFCLIENT_BLOCKS)
def test_the_log_blocks_of_cfclient_start_and_their_values_come(block):
    hangar = Hangar().run(0.1)
    first, names, second, more = CFCLIENT_BLOCKS[block]
    found = fetch_table(hangar.drone, CrtpPort.LOG)
    variables = [f"{first}.{name}" for name in names.split()]
    variables += [f"{second}.{name}" for name in more.split()]
    entries = [found[name] for name in variables]
    body = b"".join(struct.pack("<BH", kind, index) for index, kind in entries)
    for command in (b"\6\1" + body, b"\3\1\1"):
        (answer,) = hangar.drone.take(Packet(CrtpPort.LOG, 1, command))
        assert answer.data[2] == 0
    hangar.run(0.1)
    values = [p.data[4:] for p in hangar.said if (p.port, p.channel) == (5, 2)]
    assert len(values) == 10
    kinds = [hangar.drone.logs.toc.entries[index].letter for index, _ in entries]
    assert len(struct.unpack("<" + "".join(kinds), values[-1])) == len(variables)
