"""Plans of the planner on board that cflib's current programs do not ask for, but others do."""

import numpy as np
import pytest
from virtual_drones import Hangar

from crazychoir.control.senders import STOP_COMMAND
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.radio.protocol.handlers import RadioHandlerXYZ
from crazychoir.types import XYZ


def _wanted(hangar):
    """m: where the planner wants it now."""
    return [float(hangar.onboard.record["wanted"][axis]) for axis in "xyz"]


def test_it_rises_and_sinks_at_a_speed():
    hangar = Hangar().run(0.5)
    hangar.send("take_off_with_velocity", 0, 0.6, False, 0.0, True, 0.3)
    hangar.run(1.0)
    assert _wanted(hangar)[2] == pytest.approx(0.3, abs=0.02)  # half of 2 s
    hangar.run(4.0)
    assert hangar.state[2] == pytest.approx(0.6, abs=0.08)
    hangar.send(
        "land_with_velocity", 0, 0.3, True, 0.0, True, 0.0
    )  # by 0.3 m, by hlCommander.vland
    hangar.run(0.3)
    assert _wanted(hangar)[2] == pytest.approx(0.45, abs=0.02)


def test_a_speed_of_nothing_is_a_speed_all_the_same():
    hangar = Hangar().run(0.5)
    hangar.drone.parameters.set("hlCommander.vtoff", 0.0)
    (reply,) = hangar.send("take_off_with_velocity", 0, 0.6, False, 0.0, True, 0.0)
    assert (reply.data[3], hangar.drone.starts) == (0, 1)


@pytest.mark.parametrize("idle", [True, False])
def test_a_drone_that_is_sent_places_flies_even_after_streamed_set_points(idle):
    hangar = Hangar().run(
        0.5, "rpyt", 0.0, 0.0, 0.0, 0
    )  # cflib's close_link sends this set-point last
    handler = RadioHandlerXYZ(CRAZYFLIE_21)
    for command in [STOP_COMMAND] * idle + [
        XYZ("line", np.array([0.0, 0.0, 0.6, 0.0, 1.5]))
    ]:
        for packet in handler.packets(command):
            list(hangar.drone.take(packet))
        hangar.run(0.5)
    hangar.run(2.0)
    assert hangar.state[2] == pytest.approx(0.6, abs=0.08)


def test_a_plan_that_a_set_point_holds_down_is_told(caplog):
    hangar = Hangar().run(0.5, "rpyt", 0.0, 0.0, 0.0, 0)
    hangar.send("take_off", 0, 0.5, 0.0, True, 1.5)
    hangar.run(2.0)
    assert hangar.state[2] < 0.01
    assert (
        caplog.text.count(
            "a set-point holds control: send_notify_setpoint_stop ends it"
        )
        == 1
    )
    caplog.clear()
    hangar.send("take_off", 0, 0.5, 0.0, True, 1.5)
    hangar.send("notify_setpoint_stop", 0)
    hangar.run(2.0)
    assert hangar.state[2] > 0.4
    hangar.run(2.0, "hover", 0.0, 0.0, 0.0, 0.5)
    assert caplog.text == "", "no plan is sent against these set-points"


def test_a_start_of_an_undefined_trajectory_is_told(caplog):
    """The firmware answers 0 and does nothing."""
    hangar = Hangar().hovering()
    (reply,) = hangar.send("start_trajectory", 0, 0, 0, 0, 5, 1.0)
    assert reply.data[3] == 0
    hangar.run(2.0)
    assert hangar.state[2] == pytest.approx(0.5, abs=0.06)
    assert caplog.text.count("starts trajectory 5, which is not defined") == 1


def test_a_go_to_of_older_programs():
    hangar = Hangar().hovering()
    (reply,) = hangar.send("go_to_legacy", 0, 1, 0.3, 0.0, 0.1, 0.0, 1.0)
    assert reply.data[3] == 0
    hangar.run(4.0)
    assert hangar.state[:3] == pytest.approx([0.3, 0.0, 0.6], abs=0.05)


@pytest.mark.parametrize("name", ["start_trajectory_legacy", "start_trajectory"])
def test_a_trajectory_written_piece_by_piece(name):
    hangar = Hangar().hovering()
    rest, ahead = np.zeros(8), np.array([0.0, 0.0, 0.0, 0.0, 14.0, -33.6, 28.0, -8.0])
    raw = np.concatenate([rest, ahead, rest, rest, [1.0]]).astype("<f4").tobytes()
    for at in range(0, len(raw), 24):
        head = bytes([1]) + (132 + at).to_bytes(4, "little")
        (reply,) = hangar.drone.take(
            Packet(CrtpPort.MEMORY, 2, head + raw[at : at + 24])
        )
        assert reply.data[5] == 0
    (reply,) = hangar.send("define_trajectory", 7, 1, 0, 132, 1)
    assert reply.data[3] == 0
    flags = (1, 0) if name.endswith("legacy") else (1, 0, 0)
    (reply,) = hangar.send(name, 0, *flags, 7, 1.5)
    assert reply.data[3] == 0
    hangar.run(0.75)
    assert _wanted(hangar)[1] == pytest.approx(0.2, abs=0.02)
    hangar.run(3.0)
    assert hangar.state[:3] == pytest.approx([0.0, 0.4, 0.5], abs=0.05)


def test_a_compressed_one_is_flown_at_its_own_pace_alone():
    hangar = Hangar().hovering()
    raw = (
        np.zeros(4, "<i2").tobytes()
        + b"\x01"
        + (1500).to_bytes(2, "little")
        + np.array([300], "<i2").tobytes()
    )
    list(
        hangar.drone.take(Packet(CrtpPort.MEMORY, 2, bytes(1) + bytes(4) + raw))
    )  # into the EEPROM: not flown
    list(hangar.drone.take(Packet(CrtpPort.MEMORY, 2, b"\x01" + bytes(4) + raw)))
    hangar.send("define_trajectory", 1, 1, 1, 0, 1)
    for wrong in ((0, 1, 2.0), (1, 1, 1.0)):
        (reply,) = hangar.send("start_trajectory", 0, 1, 0, *wrong)
        assert reply.data[3] == 8
    (reply,) = hangar.send("start_trajectory", 0, 1, 0, 0, 1, 1.0)
    assert reply.data[3] == 0
    hangar.run(3.0)
    assert hangar.state[0] == pytest.approx(0.3, abs=0.06)
