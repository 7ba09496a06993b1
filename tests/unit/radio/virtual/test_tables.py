"""The tables of contents of virtual drones against the table of a build of the firmware."""

import csv
import struct
from importlib.resources import files

import pytest
from virtual_drones import Hangar

from crazychoir.radio.protocol.crtp import CrtpPort, Packet

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
ANY_DECK = ("any", "bcFlow|bcFlow2")


def read_rows(table, *decks):
    """Return the rows of names.csv of a table with these conditions in the column deck."""
    text = (files("crazychoir.radio.virtual") / "names.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    rows = [row for row in csv.DictReader(lines) if row["table"] == table]
    return [row for row in rows if not decks or row["deck"] in decks]


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


def test_the_table_is_that_of_the_build_without_and_with_all_decks():
    sizes = {
        table: (len(read_rows(table, "")), len(read_rows(table)))
        for table in ("log", "parameter")
    }
    assert sizes == {"log": (434, 567), "parameter": (271, 335)}


@pytest.mark.parametrize("decks", [(), ("bcFlow2",)])
def test_a_drone_serves_the_log_variables_of_its_decks_with_their_types(decks):
    hangar = Hangar(decks=decks)
    rows = read_rows("log", "", *(ANY_DECK if decks else ()))
    expected = {
        f"{row['group']}.{row['name']}": LOG_TYPE_NUMBERS[row["type"]] for row in rows
    }
    found = fetch_table(hangar.drone, CrtpPort.LOG)
    assert {name: kind for name, (_, kind) in found.items()} == expected
    assert len(found) == (444 if decks else 434)


@pytest.mark.parametrize("decks", [(), ("bcFlow2",)])
def test_a_drone_serves_the_parameters_of_its_decks_with_type_and_access(decks):
    hangar = Hangar(decks=decks)
    rows = read_rows("parameter", "", *(ANY_DECK if decks else ()))
    expected = {
        f"{row['group']}.{row['name']}": PARAMETER_TYPES[row["type"]][0]
        | 0x40 * (row["access"] == "ro")
        | 0x10 * (row["persistent"] == "yes")
        for row in rows
    }
    found = fetch_table(hangar.drone, CrtpPort.PARAMETERS)
    assert {name: kind for name, (_, kind) in found.items()} == expected
    assert len(found) == (271 + 18 + 3 if decks else 271)


def test_each_parameter_boots_and_defaults_as_in_the_firmware():
    drone = Hangar().run(0.5).drone
    found = fetch_table(drone, CrtpPort.PARAMETERS)
    for row in read_rows("parameter", ""):
        name = f"{row['group']}.{row['name']}"
        index = found[name][0].to_bytes(2, "little")
        letter = PARAMETER_TYPES[row["type"]][1]
        number = float if letter == "f" else int

        def pack(text, letter=letter, number=number):
            return struct.pack("<" + letter, number(float(text)))

        # the platform gives the mass and gains as rounded decimals
        (value,) = struct.unpack("<" + letter, ask(drone, 1, index)[3:])
        assert value == pytest.approx(float(row["boot"]), rel=1e-6), name
        default = ask(drone, 3, b"\x08", index)[3:]
        if row["access"] == "ro":
            assert default == b"\x02", name
        else:
            assert default == b"\0" + pack(row["default"] or row["boot"]), name


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


def test_each_parameter_has_a_state_and_only_persistent_ones_an_extended_type():
    drone = Hangar().drone
    found = fetch_table(drone, CrtpPort.PARAMETERS)
    for row in read_rows("parameter", ""):
        name = f"{row['group']}.{row['name']}"
        index = found[name][0].to_bytes(2, "little")
        size = struct.calcsize(PARAMETER_TYPES[row["type"]][1])
        state = ask(drone, 3, b"\x04", index)[3:]
        assert (state[:1], len(state)) == (b"\0", 1 + size), name
        is_persistent = row["persistent"] == "yes"
        extended = ask(drone, 3, b"\x07", index)[3:]
        assert extended == (b"\0\1" if is_persistent else b"\2"), name
        assert ask(drone, 3, b"\x02", index)[3:] == extended[-1:], name
        stored = ask(drone, 3, b"\x03", index)[3:]
        assert stored == (b"\0" if is_persistent else b"\2"), name


@pytest.mark.parametrize("name", ["pid_rate.roll_kp", "colAv.horizon"])
def test_a_parameter_that_is_no_number_is_stored(name):
    drone = Hangar().drone
    index = drone.parameters.toc.index[name].to_bytes(2, "little")
    nothing = struct.pack("<f", float("nan"))
    list(drone.take(Packet(CrtpPort.PARAMETERS, 2, index + nothing)))
    assert ask(drone, 1, index)[3:] == nothing
