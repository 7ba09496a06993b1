"""What a virtual Crazyflie answers, byte by byte: a conversation a port, with a drone of its own."""

import math
import re
import struct
from itertools import pairwise

import pytest
from transcripts import ALL
from virtual_drones import Hangar

from crazychoir.radio.protocol.crtp import CrtpPort, Packet, parse_packet
from crazychoir.radio.virtual.logs import pack_log_value


def _matches(pattern, reply):
    return re.fullmatch(pattern.replace(" ", ""), reply.hex()) is not None


@pytest.mark.parametrize("port", ALL)
def test_a_conversation(port):
    hangar = Hangar().run(0.5)
    for shows, request, replies in ALL[port]:
        found = [
            packet.framed()
            for packet in hangar.drone.take(parse_packet(bytes.fromhex(request)))
        ]
        assert len(found) == len(replies), shows
        for pattern, reply in zip(replies, found, strict=True):
            assert _matches(pattern, reply), (shows, pattern, reply.hex(" "))
    assert hangar.drone.starts == 1


def _table(drone, port):
    """All entries of a table of contents: (index, type, group, name)."""
    (info,) = drone.take(Packet(port, 0, b"\x03"))
    found = []
    for k in range(int.from_bytes(info.data[1:3], "little")):
        (item,) = drone.take(Packet(port, 0, b"\x02" + k.to_bytes(2, "little")))
        assert len(item.data) <= 30
        assert int.from_bytes(item.data[1:3], "little") == k
        group, name, nothing = item.data[4:].split(b"\0")
        assert nothing == b""
        found.append((item.data[3], group.decode(), name.decode()))
    return int.from_bytes(info.data[3:7], "little"), found


def test_the_tables_have_what_programs_ask_for_once_each():
    drone = Hangar(decks=("bcFlow2", "bcLedRing")).drone
    log_crc, logs = _table(drone, CrtpPort.LOG)
    param_crc, parameters = _table(drone, CrtpPort.PARAMETERS)
    assert log_crc != param_crc
    for table in (logs, parameters):
        assert len({(group, name) for _, group, name in table}) == len(table)
    logged, set_ = (
        {f"{group}.{name}" for _, group, name in table} for table in (logs, parameters)
    )
    assert {
        "stateEstimate.x",
        "kalman.varPX",
        "pm.vbat",
        "pm.state",
        "radio.rssi",
        "supervisor.info",
        "range.zrange",
        "stateEstimateZ.quat",
        "ctrltarget.x",
        "locSrv.x",
        "sys.canfly",
        "motor.m1",
    } <= logged
    assert {
        "kalman.resetEstimation",
        "stabilizer.controller",
        "stabilizer.estimator",
        "commander.enHighLevel",
        "hlCommander.groupmask",
        "locSrv.extPosStdDev",
        "ring.effect",
        "motorPowerSet.enable",
        "colAv.enable",
        "deck.bcFlow2",
        "pm.lowVoltage",
        "flightmode.stabModeYaw",
        "led.bitmask",
    } <= set_


@pytest.mark.parametrize("platform", ["cf21", "cf21bl"])
def test_when_a_battery_is_low_is_as_its_platform_has_it(platform):
    drone = Hangar(platform).drone
    entries = {entry.full: entry.boot for entry in drone.parameters.toc.entries}
    low = {"cf21": 3.2, "cf21bl": 3.35}[platform]
    assert (entries["pm.lowVoltage"], entries["pm.criticalLowVoltage"]) == (low, 3.0)
    assert drone.parameters.read("pm.lowVoltage") == low


def test_each_log_variable_can_be_read():
    hangar = Hangar(decks=("bcFlow2", "bcLighthouse4", "bcMultiranger")).hovering()
    values = {
        entry.full: hangar.log(entry.full) for entry in hangar.drone.logs.toc.entries
    }
    assert all(value == value for value in values.values())
    assert values["range.zrange"] == pytest.approx(1000.0 * hangar.state[2])
    assert values["kalman.stateZ"] == pytest.approx(0.5, abs=0.05)
    # the accelerometer in g, 0.9998 on the firmware
    assert values["controller.accelz"] == pytest.approx(1.0, abs=0.02)


def test_each_parameter_is_read_as_it_boots_or_as_the_model_has_it():
    drone = Hangar().drone
    for k, entry in enumerate(drone.parameters.toc.entries):
        (reply,) = drone.take(Packet(CrtpPort.PARAMETERS, 1, k.to_bytes(2, "little")))
        assert reply.data[2] == 0, entry
        if entry.full not in ("kalman.initialX",):
            value = drone.parameters.get(entry)
            assert value == pytest.approx(entry.boot, rel=1e-6), entry


def test_a_log_block_comes_by_the_drones_clock_and_once_if_it_has_no_period():
    hangar = Hangar().run(0.1)
    index = hangar.drone.logs.toc.index["pm.vbatMV"].to_bytes(2, "little")
    list(hangar.drone.take(Packet(CrtpPort.LOG, 1, b"\x06\x05\x22" + index)))
    list(hangar.drone.take(Packet(CrtpPort.LOG, 1, b"\x03\x05\x02")))
    hangar.run(0.2)
    data = [packet.data for packet in hangar.said if packet.port == CrtpPort.LOG]
    times = [int.from_bytes(one[1:4], "little") for one in data]
    assert [b - a for a, b in pairwise(times)] == [20] * 9
    assert 4000 < int.from_bytes(data[-1][4:], "little") <= 4200
    list(hangar.drone.take(Packet(CrtpPort.LOG, 1, b"\x04\x05")))
    list(hangar.drone.take(Packet(CrtpPort.LOG, 1, b"\x03\x05\x00")))
    hangar.said.clear()
    hangar.run(0.2)
    assert len([packet for packet in hangar.said if packet.port == CrtpPort.LOG]) == 1


@pytest.mark.parametrize(
    ("period", "count"), [(1, 1000), (2, 500), (5, 200), (7, 142), (10, 100), (25, 40)]
)
def test_a_log_block_comes_as_often_as_its_period_says_also_below_10_ms(period, count):
    """The firmware: 1000+, 509, 202, 144 packets a second at 1, 2, 5, 7 ms."""
    hangar = Hangar().run(0.1)
    list(hangar.drone.take(Packet(CrtpPort.LOG, 1, b"\x06\x05\x77\0\0")))
    list(hangar.drone.take(Packet(CrtpPort.LOG, 1, bytes([8, 5, period, 0]))))
    hangar.run(0.9)
    list(hangar.drone.take(Packet(CrtpPort.LINK, 0)))
    hangar.run(0.1)
    data = [packet.data for packet in hangar.said if packet.port == CrtpPort.LOG]
    times = [int.from_bytes(one[1:4], "little") for one in data]
    assert len(times) == count
    assert {b - a for a, b in pairwise(times)} == {period}


def test_packets_of_several_log_blocks_come_in_the_order_of_their_times():
    hangar = Hangar().run(0.1)
    for number in (1, 2):
        create = bytes([6, number, 0x77, 0, 0])
        list(hangar.drone.take(Packet(CrtpPort.LOG, 1, create)))
        list(hangar.drone.take(Packet(CrtpPort.LOG, 1, bytes([8, number, 2, 0]))))
    hangar.run(0.1)
    data = [packet.data for packet in hangar.said if packet.port == CrtpPort.LOG]
    assert [one[0] for one in data[:4]] == [1, 2, 1, 2]


def test_a_half_float_too_large_stays_at_the_end_of_its_range():
    assert pack_log_value("e", 1e9) == pack_log_value("e", 65504.0)
    assert pack_log_value("H", 70000.0) == b"\xff\xff"
    assert pack_log_value("h", -70000.0) == b"\x00\x80"
    assert [pack_log_value("b", math.inf), pack_log_value("I", -math.inf)] == [
        b"\x7f",
        bytes(4),
    ]
    assert [pack_log_value("i", math.nan), pack_log_value("f", 1e39)] == [
        bytes(4),
        bytes(4),
    ]
    assert all(
        math.isnan(struct.unpack("<" + letter, pack_log_value(letter, math.nan))[0])
        for letter in "ef"
    )


def test_each_log_variable_of_a_broken_drone_is_sent():
    hangar = Hangar(decks=("bcFlow2", "bcMultiranger")).hovering()
    record = hangar.onboard.record
    for wrong in (math.nan, math.inf, -math.inf, 1e300):
        for name in record.dtype.names:
            if record.dtype[name].kind == "f":
                record[name] = wrong
        for part, names in (
            ("wanted", ("x", "vx", "ax", "thrust")),
            ("request", range(4)),
        ):
            for name in names:
                record[part][name] = wrong
        for entry in hangar.drone.logs.toc.entries:
            for letter in "bBhHiIef":
                assert len(
                    pack_log_value(letter, hangar.log(entry.full))
                ) == struct.calcsize(letter), entry.full


def test_the_console_splits_no_character():
    drone = Hangar().drone
    list(drone.pass_time())
    drone.console.say("ä" * 40)
    texts = [packet.data.decode() for packet in drone.pass_time()]
    assert "".join(texts) == "ä" * 40
    assert all(len(text.encode()) <= 30 for text in texts)


@pytest.mark.parametrize(
    ("decks", "kinds"),
    [
        ((), [0x00, 0x12, 0x15, 0x19]),
        (("bcFlow2", "bcMultiranger"), [0x00, 0x12, 0x15, 0x19]),
        (("bcLighthouse4",), [0x00, 0x12, 0x15, 0x14, 0x19]),
        (
            ("bcLighthouse4", "bcLedRing"),
            [0x00, 0x12, 0x15, 0x10, 0x17, 0x14, 0x19],
        ),
    ],
)
def test_a_deck_brings_its_memories(decks, kinds):
    """The firmware without decks: EEPROM, trajectories, tester, sections of decks."""
    drone = Hangar(decks=decks).drone
    (count,) = drone.take(Packet(CrtpPort.MEMORY, 0, b"\x01"))
    found = [
        next(drone.take(Packet(CrtpPort.MEMORY, 0, bytes([2, number])))).data[2]
        for number in range(count.data[1])
    ]
    assert found == kinds


def test_the_tester_counts_packets_with_wrong_bytes_until_it_is_reset():
    """The firmware: mem.c counts the first wrong byte of a packet."""
    hangar = Hangar()
    wrong = Packet(CrtpPort.MEMORY, 2, bytes([2, 0, 0, 0, 0, 9, 9, 9]))
    right = Packet(CrtpPort.MEMORY, 2, bytes([2, 0, 0, 0, 0, 0, 1, 2]))
    for packet in (wrong, right, wrong):
        list(hangar.drone.take(packet))
    assert hangar.log("memTst.errCntW") == 2.0
    hangar.drone.parameters.set("memTst.resetW", 1.0)
    list(hangar.drone.take(wrong))
    assert hangar.log("memTst.errCntW") == 1.0
    assert hangar.drone.parameters.read("memTst.resetW") == 0.0


def test_the_console_says_what_starts_and_each_line_ends_its_packet():
    """The firmware: `SYS: Crazyflie 2.1 is up and running!`, then decks and the self-test."""
    drone = Hangar(decks=("bcFlow2",)).drone
    texts = [packet.data.decode() for packet in drone.pass_time()]
    lines = "".join(texts).splitlines()
    assert "SYS: Crazyflie 2.1 is up and running!" in lines
    assert "DECK_CORE: 1 deck(s) found" in lines
    assert lines[-1] == "SYS: Self test passed!"
    assert all("\n" not in text[:-1] for text in texts)


def test_log_blocks_are_forgotten_after_a_second_without_packets():
    hangar = Hangar().run(0.1)
    list(hangar.drone.take(Packet(CrtpPort.LOG, 1, b"\x06\x05\x77\0\0")))
    list(hangar.drone.take(Packet(CrtpPort.LOG, 1, b"\x03\x05\x02")))
    hangar.run(0.95)
    list(hangar.drone.take(Packet(15, 0, b"ping")))
    hangar.run(0.95)
    assert 5 in hangar.drone.logs.blocks
    hangar.run(0.1)
    (reply,) = hangar.drone.take(Packet(CrtpPort.LOG, 1, b"\x03\x05\x02"))
    assert reply.data == b"\x03\x05\x02"  # there is no such block


def test_a_reset_of_the_estimator_is_taken_back_by_the_drone_which_says_so():
    drone = Hangar().run(0.5).drone
    index = drone.parameters.toc.index["kalman.resetEstimation"].to_bytes(2, "little")
    echoed, updated = drone.take(Packet(CrtpPort.PARAMETERS, 2, index + b"\1"))
    assert echoed.data == index + b"\1"
    assert (updated.channel, updated.data) == (3, b"\1" + index + b"\0")
    assert drone.onboard.log("kalman.varX") == pytest.approx(1e4)
    assert len(list(drone.take(Packet(CrtpPort.PARAMETERS, 2, index + b"\0")))) == 1


def test_motors_turn_by_parameters_whatever_the_supervisor_says():
    hangar = Hangar().run(0.5)
    hangar.drone.parameters.set("motorPowerSet.enable", 1.0)
    hangar.drone.parameters.set("motorPowerSet.m2", 20000.0)
    hangar.send("emergency_stop")
    hangar.run(0.1)
    assert [hangar.log(f"motor.m{k}") for k in (1, 2, 3, 4)] == [0.0, 20000.0, 0.0, 0.0]
    hangar.drone.parameters.set("motorPowerSet.enable", 0.0)
    hangar.run(0.1)
    assert not hangar.motors
