"""Effects of the parameters of a virtual drone, and its text about inert parameters."""

import math
import struct
from importlib.resources import files

import pytest
from virtual_drones import Hangar

from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.radio.virtual.parameter_effects import DRONE_PARAMETERS, is_modelled


def write(hangar, name, value):
    """Write a parameter as a client does; return the answers."""
    toc = hangar.drone.parameters.toc
    k = toc.index[name]
    packed = struct.pack("<" + toc.entries[k].letter, value)
    return list(
        hangar.drone.take(
            Packet(CrtpPort.PARAMETERS, 2, k.to_bytes(2, "little") + packed)
        )
    )


def read_console(hangar):
    """Return what the drone has said since the last call."""
    packets = [*hangar.said, *hangar.drone.pass_time()]
    hangar.said = []
    texts = [p.data.decode() for p in packets if p.port == CrtpPort.CONSOLE]
    return "".join(texts)


def test_an_inert_parameter_is_taken_and_the_drone_says_once_that_it_does_nothing():
    hangar = Hangar().run(0.1)
    read_console(hangar)
    assert not is_modelled("kalman.mNBaro")
    write(hangar, "kalman.mNBaro", 2.0)
    assert read_console(hangar) == "", "2 is its value after a start"
    (answer,) = write(hangar, "kalman.mNBaro", 3.0)
    assert answer.channel == 2
    assert read_console(hangar) == "PARAM: kalman.mNBaro is not simulated: no effect\n"
    write(hangar, "kalman.mNBaro", 4.0)
    assert read_console(hangar) == ""
    assert hangar.drone.parameters.read("kalman.mNBaro") == 4.0


def test_a_stored_inert_parameter_is_told_at_each_start():
    hangar = Hangar().run(0.1)
    hangar.drone.kept.parameters["kalman.mNBaro"] = 3.0
    hangar.drone.restart()
    hangar.run(1.1)
    assert "kalman.mNBaro is not simulated" in read_console(hangar)


@pytest.mark.parametrize("name", ["pid_rate.roll_kp", "hlCommander.groupmask"])
def test_a_parameter_with_an_effect_is_not_told(name):
    hangar = Hangar().run(0.1)
    read_console(hangar)
    write(hangar, name, 3)
    assert read_console(hangar) == ""


def test_each_parameter_of_the_drone_is_used_by_a_file_of_the_drone():
    sources = {
        path.name: path.read_text(encoding="utf-8")
        for path in files("crazychoir.radio.virtual").iterdir()
        if path.name.endswith(".py")
    }
    table = sources["parameter_effects.py"]
    used = table[table.index("class WriteEffects") :]
    used += "".join(
        text for name, text in sources.items() if name != "parameter_effects.py"
    )
    unused = [name for name in DRONE_PARAMETERS if f'"{name}"' not in used]
    assert unused == ["commander.enHighLevel"], "it does nothing in the firmware either"


def test_an_echo_waits_as_many_ms_as_its_parameter_says():
    hangar = Hangar().run(0.1)
    ping = Packet(CrtpPort.LINK, 0, b"ping")
    assert list(hangar.drone.take(ping)) == [ping]
    write(hangar, "crtpsrv.echoDelay", 200)
    assert list(hangar.drone.take(ping)) == []
    assert list(hangar.drone.take(ping)) == []
    echoes = []
    for _ in range(5):
        hangar.said.clear()
        hangar.run(0.1)
        echoes.append(hangar.said.count(ping))
    assert echoes == [0, 1, 0, 1, 0], "the second one waits for the first"


def test_the_console_says_what_parameters_ask_for():
    hangar = Hangar().run(0.5)
    read_console(hangar)
    hangar.drone.kept.parameters["pid_rate.roll_kp"] = 240.0
    for name, words in (
        ("supervisor.infdmp", "SUP: state: ready to fly\nSUP: info: 0x020e\n"),
        ("system.storageStats", "STORAGE: 1 parameters\n"),
        ("system.assertInfo", "SYS: no failed assert\n"),
    ):
        write(hangar, name, 1)
        assert read_console(hangar) == words
        assert hangar.drone.parameters.read(name) == 0.0
    write(hangar, "system.storageReformat", 1)
    assert hangar.drone.kept.parameters == {}
    hangar.drone.fail_assertion("a test")
    hangar.run(1.1)
    read_console(hangar)
    write(hangar, "system.assertInfo", 1)
    assert read_console(hangar) == "SYS: an assertion has failed\n"


def test_decks_measure_unless_a_parameter_forbids_it():
    drone = Hangar(decks=("bcFlow2", "bcLighthouse4")).drone
    assert (drone.flows, drone.positioned) == (True, True)
    drone.parameters.set("motion.disable", 1.0)
    drone.parameters.set("lighthouse.fwdToEstimator", 0.0)
    assert (drone.flows, drone.positioned) == (False, False)
    assert drone.has_position_deck


def send_rpyt(hangar, roll, pitch, yaw, thrust):
    hangar.send("rpyt", 0.0, 0.0, 0.0, 0)
    hangar.send("rpyt", roll, pitch, yaw, thrust)
    return lambda name: hangar.log(f"ctrltarget.{name}")


def test_with_althold_the_thrust_of_rpyt_is_a_climb():
    hangar = Hangar().run(0.5)
    write(hangar, "flightmode.althold", 1)
    target = send_rpyt(hangar, 5.0, 0.0, 0.0, 49151)
    assert (target("mode_z"), target("thrust"), target("roll")) == (2, 0.0, 5.0)
    assert target("vz") == pytest.approx(0.5, abs=1e-4)


def test_with_poshold_the_angles_of_rpyt_are_a_velocity():
    hangar = Hangar().run(0.5)
    write(hangar, "flightmode.poshold", 1)
    target = send_rpyt(hangar, 6.0, 15.0, 0.0, 40000)
    assert [target(f"mode_{a}") for a in ("x", "y", "z", "roll", "pitch")] == [
        *(2, 2, 0),
        *(0, 0),
    ]
    assert [target(a) for a in ("vx", "vy", "thrust")] == [0.5, 0.2, 40000.0]


def test_with_posset_the_numbers_of_rpyt_are_a_position():
    hangar = Hangar().run(0.5)
    write(hangar, "flightmode.posSet", 1)
    target = send_rpyt(hangar, 0.3, -0.2, 45.0, 700)
    assert [target(f"mode_{a}") for a in ("x", "y", "z", "yaw")] == [1, 1, 1, 1]
    place = [target(a) for a in "xyz"]
    assert place == pytest.approx([0.2, 0.3, 0.7], abs=1e-6)
    hangar.run(2.0, "rpyt", 0.3, -0.2, 45.0, 700)
    assert hangar.state[:3] == pytest.approx([0.2, 0.3, 0.7], abs=0.1)


def test_in_the_plus_mode_of_yaw_motor_1_is_in_front():
    hangar = Hangar().run(0.5)
    write(hangar, "flightmode.yawMode", 1)
    target = send_rpyt(hangar, 0.0, 10.0, 0.0, 40000)
    half = 10.0 * math.sqrt(0.5)
    assert (target("roll"), target("pitch")) == pytest.approx((-half, half))


def test_the_carefree_mode_of_yaw_fails_an_assertion():
    hangar = Hangar().run(0.5)
    write(hangar, "flightmode.yawMode", 0)
    assert hangar.drone.starts == 1
    hangar.send("rpyt", 0.0, 0.0, 0.0, 0)
    assert hangar.drone.starts == 2


@pytest.mark.parametrize(
    ("name", "value", "variance", "growth"),
    [
        ("kalman.pNPos", 0.01, "varZ", 1000 * 0.01**2),
        ("kalman.pNVel", 0.01, "varPZ", 1000 * (1e-3 + 0.01) ** 2),
        ("kalman.pNAtt", 0.01, "varD0", 1000 * (1e-4 + 0.01) ** 2),
        ("kalman.mNGyro_yaw", 10.0, "varD2", 1000 * 0.01**2),
    ],
)
def test_the_noise_of_the_filter_grows_its_variance(name, value, variance, growth):
    hangar = Hangar(told=False).run(0.5)
    write(hangar, name, value)
    before = hangar.log(f"kalman.{variance}")
    hangar.run(1.0)
    found = hangar.log(f"kalman.{variance}") - before
    # the variance of the velocity adds to that of the position
    assert found == pytest.approx(growth, rel=0.02)
