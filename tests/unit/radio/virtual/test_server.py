"""The server: ports, cameras, questions, faults. Its world is stepped by hand, its sockets are real."""

import asyncio
import json
import socket
import threading

import numpy as np
import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, Refused
from crazychoir.mocap.frames import FRAME_PROTOCOL, parse_frame
from crazychoir.radio.protocol.crtp import PACKET_FORMS, Packet
from crazychoir.radio.virtual.control import QUESTION_LIMITS, ask_server
from crazychoir.radio.virtual.drone import BOOT_TIME
from crazychoir.radio.virtual.faults import FAULT_SETTINGS, Faults, check_faults
from crazychoir.radio.virtual.server import VirtualServer
from crazychoir.radio.virtual.setup import (
    dongle_groups,
    parse_decks,
    place_on_grid,
    select_from_swarm,
)
from crazychoir.runtime.clock import WallClock

CONSOLE = b"\x0c"
ECHO = Packet(15, 0, b"hello").framed()


def _free(count):
    """The second of so many free ports in a row."""
    for first in range(24_000, 60_000, 40):
        doors = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
        try:
            for k, door in enumerate(doors):
                door.bind(("127.0.0.1", first + k))
            return first + 1
        except OSError:
            continue
        finally:
            for door in doors:
                door.close()
    raise AssertionError("no free ports")


class Open:
    """A server of some drones, with a client's socket."""

    def __init__(self, n=2, decks=None):
        self.n, self.decks = n, decks

    async def __aenter__(self):
        self.clock = WallClock(asyncio.get_running_loop())
        self.port = _free(self.n + 1)
        hall = place_on_grid(self.n, self.port, self.decks)
        self.server = VirtualServer(self.clock, hall.world(0), hall.seats, hall.poses)
        self.server.listen()
        self.door = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.door.setblocking(False)
        return self

    async def __aexit__(self, *error):
        await self.server.on_stop()
        self.door.close()
        self.clock.close()

    def run(self, seconds):
        for _ in range(round(seconds / self.server.world.dt)):
            self.server.step(self.server.world.time)

    async def said(self, data, drone=0, port=None, patience=10.0):
        """What a datagram is answered; empty for silence, a text for an error."""
        self.door.connect(("127.0.0.1", self.port + drone if port is None else port))
        try:
            self.door.send(data)
            async with asyncio.timeout(patience):
                while (
                    answer := await asyncio.get_running_loop().sock_recv(
                        self.door, 65_000
                    )
                )[:1] == CONSOLE:
                    pass
                return answer
        except TimeoutError:
            return b""
        except ConnectionRefusedError:
            return "refused"

    async def is_silent_about(self, data, port=None):
        return await self.said(data, port=port, patience=0.2) == b""

    async def asked(self, question):
        return json.loads(
            await self.said(json.dumps(question).encode(), port=self.port - 1)
        )

    def take_off(self, drone=0):
        self.run(0.5)
        list(
            self.server.ports[drone].drone.take(
                PACKET_FORMS["take_off"].packet(0, 0.6, 0.0, True, 1.0)
            )
        )
        self.run(2.0)

    def height(self, drone=0):
        return float(self.server.world.states[drone, 2])


async def test_a_client_is_answered_and_a_scan_is_none():
    async with Open() as hall:
        assert await hall.said(b"\xff") != b""
        assert hall.server.ports[0].client is None
        assert await hall.said(ECHO) == ECHO
        assert hall.server.ports[0].client is not None
        assert await hall.said(ECHO, drone=1) == ECHO
        assert await hall.is_silent_about(bytes(40))
        assert hall.server.ports[0].malformed == 1


async def test_a_taken_port_is_named_and_no_other_stays_open():
    async with Open(3) as hall:
        hall.server.ports[0].close()
        again = place_on_grid(3, hall.port, ())
        with pytest.raises(ConfigError, match=f"UDP port {hall.port + 1}"):
            VirtualServer(hall.clock, again.world(0), again.seats, again.poses).listen()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
            door.bind(("127.0.0.1", hall.port))


async def test_a_restart_closes_its_port_until_it_has_started():
    async with Open() as hall:
        assert await hall.said(ECHO) == ECHO
        assert (await hall.asked({"faults": {"0": {"reboot": 1}}}))["done"]
        hall.run(0.05)
        assert await hall.said(ECHO) == "refused"
        assert await hall.said(ECHO, drone=1) == ECHO
        hall.run(1e-3 * BOOT_TIME)
        assert await hall.said(ECHO) == ECHO


async def test_switched_off_it_is_not_there_and_falls():
    async with Open() as hall:
        hall.take_off()
        assert hall.height() > 0.5
        await hall.asked({"faults": {"0": {"off": 1}}})
        hall.run(1.5)
        assert hall.height() == 0.0
        assert await hall.said(ECHO) == "refused"
        assert (await hall.asked({"ask": "state"}))["drones"]["0"][
            "supervisor"
        ] == "off"
        await hall.asked({"faults": {"0": {"off": 0}}})
        hall.run(1e-3 * BOOT_TIME + 0.1)
        assert await hall.said(ECHO) == ECHO
        hall.take_off()
        assert hall.height() > 0.5


async def test_silent_it_is_there_and_says_nothing():
    async with Open() as hall:
        await hall.asked({"faults": {"0": {"silent": 1}}})
        assert await hall.is_silent_about(ECHO)
        assert await hall.is_silent_about(b"\xff")
        await hall.asked({"faults": {"all": {"silent": 0}}})
        assert await hall.said(ECHO) == ECHO


async def test_what_breaks_a_drone_in_flight():
    async with Open(4) as hall:
        for drone in range(4):
            hall.take_off(drone)
        await hall.asked(
            {"faults": {"0": {"tumble": 1}, "1": {"motor": 2}, "2": {"voltage": 3.3}}}
        )
        hall.run(7.0)
        state = (await hall.asked({"ask": "state"}))["drones"]
        assert state["0"]["supervisor"] == "crashed"
        assert state["0"]["tumbled"] is True
        assert state["1"]["p"][2] < 0.1
        assert hall.server.drones[2].logs.read("pm.state") == 3.0
        assert state["2"]["vbat"] < 3.3
        assert state["3"]["p"][2] == pytest.approx(0.6, abs=0.05)
        assert state["3"]["last"] == ""
        assert state["3"]["zeros"] == 0
        assert state["3"]["motors"][0] > 0.1


async def test_a_fallen_drone_is_carried_home_and_flies_again():
    async with Open(2) as hall:
        home = hall.server.world.states[1].copy()
        _in_the_air(hall)
        hall.server.world.states[1, 3] = 2.0
        await hall.asked({"faults": {"1": {"off": 1}}})
        hall.run(1.5)
        assert "hit the floor" in hall.server.questions.describe_drone(1)["crashed"]
        assert hall.server.questions.describe_drone(1)["p"][0] > 1.0
        await hall.asked({"faults": {"1": {"off": 0, "home": 1, "reboot": 1}}})
        hall.run(1e-3 * BOOT_TIME + 0.5)
        assert hall.server.questions.describe_drone(1)["crashed"] == ""
        assert np.allclose(hall.server.world.states[1], home, atol=1e-3)
        hall.take_off(1)
        assert hall.height(1) > 0.5
        assert hall.height(0) == pytest.approx(0.6, abs=0.1)


async def test_a_fall_can_be_forgotten_and_the_next_one_is_seen():
    async with Open(2) as hall:
        for _ in range(2):
            _in_the_air(hall)
            await hall.asked({"faults": {"1": {"off": 1}}})
            hall.run(1.5)
            await hall.asked({"faults": {"1": {"off": 0, "reboot": 1}}})
            hall.run(1e-3 * BOOT_TIME + 0.5)
            assert "hit the floor" in hall.server.questions.describe_drone(1)["crashed"]
            await hall.asked({"faults": {"1": {"mend": 1}}})
            hall.run(0.1)
            assert hall.server.questions.describe_drone(1)["impact"] == 0.0


def _in_the_air(hall):
    for drone in range(hall.n):
        hall.take_off(drone)


async def _fly_on(hall, caplog):
    """Drone 1 of three is named, and has started anew; the others hover. The truth about it."""
    state = (await hall.asked({"ask": "state"}))["drones"]
    assert [record.getMessage()[:23] for record in caplog.records] == [
        "virtual drone 1: reset:"
    ]
    assert [state[i]["starts"] for i in "012"] == [1, 2, 1]
    assert [state[i]["p"][2] for i in "02"] == pytest.approx([0.6, 0.6], abs=0.1)
    assert await hall.said(ECHO, drone=1) == ECHO
    return state["1"]


async def test_a_body_that_is_nowhere_stands_at_home_again_and_the_others_fly_on(
    caplog,
):
    async with Open(3) as hall:
        home = hall.server.world.states[1].copy()
        _in_the_air(hall)
        await hall.asked({"faults": {"1": {"motor": 2}}})
        hall.server.world.states[1, 3] = np.nan
        hall.run(1e-3 * BOOT_TIME + 0.5)
        assert (await _fly_on(hall, caplog))["vbat"] > 4.0
        assert np.allclose(hall.server.world.states[1], home, atol=1e-3)
        hall.take_off(1)
        assert hall.height(1) < 0.3, "a motor that was broken is broken still"
        hall.server.world.states[1, 0] = np.inf
        await hall.asked({"faults": {"1": {"motor": 0}}})
        hall.run(1e-3 * BOOT_TIME)
        hall.take_off(1)
        assert hall.height(1) > 0.5


async def test_a_firmware_that_reckons_with_no_numbers_is_reset_and_the_others_fly_on(
    caplog,
):
    async with Open(3) as hall:
        _in_the_air(hall)
        hall.server.world.onboard[1].record["roll_pid"]["integral"] = np.nan
        hall.run(1e-3 * BOOT_TIME + 0.5)
        assert (await _fly_on(hall, caplog))["p"][2] < 0.1


async def test_what_a_drone_cannot_bear_restarts_it_alone(monkeypatch, caplog):
    async with Open(2) as hall:
        hall.take_off(0)
        drone = hall.server.ports[1].drone
        monkeypatch.setattr(drone.logs, "due", lambda now: 1 / 0)
        hall.run(0.01)
        monkeypatch.undo()
        assert (
            "virtual drone 1: what it says by itself: ZeroDivisionError" in caplog.text
        )
        hall.run(1e-3 * BOOT_TIME)
        monkeypatch.setattr(drone.parameters, "take", lambda packet: [][0])
        assert list(drone.take(Packet(2, 1, b"\0\0"))) == []
        assert (
            "virtual drone 1: a packet of port 2, channel 1: IndexError" in caplog.text
        )
        hall.run(0.5)
        assert drone.starts == 3
        assert hall.height(0) == pytest.approx(0.6, abs=0.1)


async def test_the_cameras_show_the_truth_as_long_as_a_client_asks():
    async with Open(3, decks=()) as hall:
        assert await hall.is_silent_about(FRAME_PROTOCOL.request, port=hall.port - 1)
        hall.run(0.02)
        frame = parse_frame(hall.door.recv(65_000))
        assert list(frame.bodies) == ["cf0", "cf1", "cf2"]
        assert np.allclose(
            frame.bodies["cf1"], hall.server.world.states[1, [0, 1, 2, 6, 7, 8, 9]]
        )
        after = parse_frame(hall.door.recv(65_000))
        assert (after.number, after.time) == (
            frame.number + 1,
            pytest.approx(frame.time + 0.01),
        )


async def test_what_goes_wrong_with_the_cameras():
    async with Open(3, decks=()) as hall:
        await hall.asked(
            {"faults": {"0": {"pose_lost": 1}, "1": {"offset": [0.1, 0.0, -0.2]}}}
        )
        assert await hall.is_silent_about(FRAME_PROTOCOL.request, port=hall.port - 1)
        hall.run(0.01)
        bodies = parse_frame(hall.door.recv(65_000)).bodies
        assert set(bodies) == {"cf1", "cf2"}
        assert np.allclose(
            bodies["cf1"][:3] - hall.server.world.states[1, :3], (0.1, 0.0, -0.2)
        )
        await hall.asked(
            {"faults": {"0": {"pose_lost": 0}, "1": {"offset": [0, 0, 0], "swap": 2}}}
        )
        assert await hall.is_silent_about(FRAME_PROTOCOL.request, port=hall.port - 1)
        hall.run(0.01)
        bodies = parse_frame(hall.door.recv(65_000)).bodies
        assert np.allclose(bodies["cf1"][:3], hall.server.world.states[2, :3])
        assert np.allclose(bodies["cf2"][:3], hall.server.world.states[1, :3])
        await hall.asked({"faults": {"2": {"swap": -1}}})
        assert all(fault.swap == -1.0 for fault in hall.server.faults.values())


async def test_a_deck_tells_where_it_is_and_without_one_nothing_does():
    async with Open(2) as hall:
        hall.run(0.5)
        assert hall.server.drones[1].onboard.estimate.p[0] == pytest.approx(
            0.6, abs=0.01
        )
    async with Open(2, decks=()) as hall:
        hall.run(0.5)
        assert hall.server.drones[1].onboard.estimate.p[0] == pytest.approx(
            0.0, abs=0.05
        )


@pytest.mark.parametrize(
    ("question", "says"),
    [
        ({"faults": {"7": {"loss": 0.1}}}, "all, 0, 1"),
        ({"faults": {"0": {"lost": 0.1}}}, "loss, delay, silent"),
        ({"faults": {"0": {"loss": 1.5}}}, "0 to 1"),
        ({"faults": {"0": {"loss": "much"}}}, "0 to 1"),
        ({"faults": {"0": {"motor": 1.5}}}, "0 to 4"),
        ({"faults": {"0": {"offset": 1.0}}}, "3 numbers of -10 to 10"),
        ({"faults": {"0": {"voltage": 1.0}}}, "0, or 3 to 4.2"),
        ({"faults": {"0": {"swap": 5}}}, "-1, or one of 0, 1"),
        ({"faults": [1]}, "{id: {name: value}}"),
        ({"ask": "what"}, '{"ask": "state"}'),
        ([1, 2], "a JSON object"),
    ],
)
async def test_what_cannot_be_is_refused_with_what_can(question, says):
    async with Open() as hall:
        assert says in (await hall.asked(question))["error"]
        assert all(fault == Faults() for fault in hall.server.faults.values())


def test_an_absent_server_is_reported():
    with pytest.raises(Refused, match="crazychoir virtual"):
        ask_server({"ask": "state"}, port=9, deadline=0.1)


def test_what_a_battery_may_have_is_said_before_it_is_refused():
    assert FAULT_SETTINGS["voltage"].allowed == "0, or 3 to 4.2"
    for value in (0.0, 3.0, 4.2):
        assert check_faults({"voltage": value}, [0]) == {"voltage": value}
    for value in (2.9, 4.3, -1.0, float("nan")):
        with pytest.raises(ConfigError, match="0, or 3 to"):
            check_faults({"voltage": value}, [0])


def test_each_fault_that_can_be_set_is_one_of_a_drone():
    assert set(FAULT_SETTINGS) == {*Faults().listed(), "home", "reboot", "mend"}
    assert check_faults({"offset": [1, 2, 3]}, [0]) == {"offset": (1.0, 2.0, 3.0)}


SWARM = {
    "name": "six",
    "drones": [
        {
            "id": 4,
            "home": [0, 0, 0],
            "uri": "udp://127.0.0.1:19860",
            "dongle": 1,
            "pose": "onboard",
            "platform": "cf21bl",
        },
        {
            "id": 2,
            "home": [1, 0, 0],
            "uri": "udp://localhost:19870",
            "dongle": 0,
            "body": "marker",
            "yaw": 1.0,
        },
        {"id": 3, "home": [2, 0, 0], "uri": "udp://127.0.0.1:19871", "dongle": 0},
        {"id": 0, "home": [3, 0, 0]},
    ],
    "radio": {"capacity": 200.0, "log_rate": 50.0},
}


def test_the_drones_of_a_swarm_stand_at_home_at_their_ports():
    hall = select_from_swarm(SwarmConfig.of(SWARM, "x"), None)
    seats = {seat.id: seat for seat in hall.seats}
    assert {i: seat.at[1] for i, seat in seats.items()} == {
        4: 19860,
        2: 19870,
        3: 19871,
    }
    assert (seats[2].body, seats[3].body) == ("marker", "cf3")
    assert (seats[4].decks != (), seats[3].decks) == (True, ())
    assert (seats[4].device, seats[3].device) == (
        "Crazyflie 2.1 Brushless",
        "Crazyflie 2.1",
    )
    world = hall.world(0)
    assert np.allclose(world.state(2).p, (1, 0, 0))
    assert dict(dongle_groups(hall, None, None)) == {(2, 3): 200.0, (4,): None}
    assert hall.poses == ("127.0.0.1", 19849)


def test_a_swarm_without_virtual_drones_is_refused():
    simulated = {"name": "x", "drones": [{"id": 0, "home": [0, 0, 0]}]}
    with pytest.raises(ConfigError, match="udp://HOST:PORT on this machine"):
        select_from_swarm(SwarmConfig.of(simulated, "x"), None)


def test_groups_of_drones_that_share_a_dongle():
    hall = place_on_grid(5, 19850, ())
    assert [group for group, _ in dongle_groups(hall, "0,1|4", None)] == [(0, 1), (4,)]
    assert [group for group, _ in dongle_groups(hall, None, 2)] == [
        (0, 1),
        (2, 3),
        (4,),
    ]
    for wrong in ("0,0", "0|9", "a", ""):
        with pytest.raises(ConfigError, match="groups of drones"):
            dongle_groups(hall, wrong, None)


def test_decks_by_name():
    assert parse_decks("none") == ()
    assert parse_decks("bcFlow2,bcLighthouse4") == ("bcFlow2", "bcLighthouse4")
    with pytest.raises(ConfigError, match="bcLighthouse4 knows where it is"):
        parse_decks("flow")


async def _called(*words):
    return await asyncio.to_thread(
        CliRunner().invoke, app, ["virtual", *map(str, words)]
    )


async def test_the_command_line_lists_sets_and_refuses_faults(tmp_path):
    async with Open() as hall:
        port = ("--port", hall.port)
        done = await _called("fault", "0,1", "loss=0.25", "offset=0.1,0,0", *port)
        assert done.exit_code == 0, done.output
        assert [fault.loss for fault in hall.server.faults.values()] == [0.25, 0.25]
        done = await _called("faults", "--json", *port)
        assert json.loads(done.stdout)["drones"]["1"]["offset"] == [0.1, 0.0, 0.0]
        assert "0.25" in (await _called("faults", *port)).stdout
        assert "not initialised" in (await _called("state", *port)).stdout
        config = SwarmConfig.of(SWARM | {"mocap": {"port": hall.port - 1}})
        (tmp_path / "swarm.json").write_text(config.dumps())
        done = await _called("faults", "--swarm", tmp_path / "swarm.json", "--json")
        assert json.loads(done.stdout)["drones"]["0"]["loss"] == 0.25
        for words, says in (
            (("fault", "0", "loss=2"), "0 to 1"),
            (("fault", "0", "loss"), "loss=0.3"),
        ):
            done = await _called(*words, *port, "--json")
            assert done.exit_code == 2
            assert says in json.loads(done.stdout)["error"]
    assert (await _called("state", "--port", 45_001)).exit_code == 2


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--dongles", "0,0"), "groups of drones"),
        (("--dongles", "0", "--per-dongle", "1"), "one of them"),
        (("--deck", "flow"), "bcFlow2"),
        (("--firmware", "é"), "plain characters"),
    ],
)
def test_options_that_cannot_be_are_refused(words, says):
    done = CliRunner().invoke(app, ["virtual", *words, "--json"])
    assert done.exit_code == 2
    assert says in json.loads(done.stdout)["error"]


def test_a_taken_port_is_said_with_what_to_do_about_it(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        door.bind(("127.0.0.1", 0))
        port = door.getsockname()[1]
        rows = [{"id": 0, "home": [0, 0, 0], "uri": f"udp://127.0.0.1:{port}"}]
        (tmp_path / "swarm.json").write_text(
            SwarmConfig.of({"name": "a", "drones": rows}).dumps()
        )
        for words, says in (
            (("--port", port), "Choose another --port."),
            (
                ("--swarm", tmp_path / "swarm.json"),
                "another `crazychoir virtual`, or another program, has it",
            ),
        ):
            done = CliRunner().invoke(app, ["virtual", *map(str, words), "--json"])
            assert done.exit_code == 2
            said = json.loads(done.stdout)["error"]
            assert f"UDP port {port} of 127.0.0.1" in said
            assert says in said
            assert ("--port" in said) == ("--port" in words)


class Datagrams:
    """Counts what the server sends at its cameras' port."""

    def __init__(self, cameras):
        self.sizes = []
        self._send, cameras._send = cameras._send, self.send

    def send(self, datagram, to):
        self.sizes.append(len(datagram))
        self._send(datagram, to)


@pytest.mark.parametrize("n", [1, 60, 126, 127, 200])
async def test_questions_about_many_drones_are_answered_in_parts_that_fit_into_datagrams(
    n,
):
    async with Open(n, decks=()) as hall:
        sent = Datagrams(hall.server.cameras)
        where = {"port": hall.port - 1, "deadline": 20.0}
        state = await asyncio.to_thread(ask_server, {"ask": "state"}, **where)
        faults = await asyncio.to_thread(ask_server, {"ask": "faults"}, **where)
        assert list(state) == ["time", "drones"]
        assert (
            list(state["drones"])
            == list(faults["drones"])
            == [str(i) for i in range(n)]
        )
        assert all(
            state["drones"][str(i)]["at"] == list(seat.at)
            for i, seat in enumerate(hall.server.seats)
        )
        assert max(sent.sizes) <= QUESTION_LIMITS.datagram_size
        names = ",".join(map(str, range(n)))
        await asyncio.to_thread(
            ask_server,
            {"faults": {names: {"loss": 0.25, "offset": [0.1, 0.0, 0.0]}}},
            **where,
        )
        assert {fault.loss for fault in hall.server.faults.values()} == {0.25}
        with pytest.raises(Refused, match="all, 0"):
            await asyncio.to_thread(
                ask_server, {"faults": {f"{names},777": {"loss": 0.5}}}, **where
            )
        assert {fault.loss for fault in hall.server.faults.values()} == {0.25}, (
            "all of them, or none"
        )


async def test_a_question_or_an_answer_that_no_datagram_holds_is_refused_and_said():
    async with Open() as hall:
        where = {"port": hall.port - 1, "deadline": 20.0}
        with pytest.raises(Refused, match=r"a question of \d+ bytes"):
            await asyncio.to_thread(
                ask_server, {"faults": {"0": {"x" * 70_000: 1.0}}}, **where
            )
        long = (
            await asyncio.gather(
                asyncio.to_thread(ask_server, {"ask": "?" * 60_000}, **where),
                return_exceptions=True,
            )
        )[0]
        assert isinstance(long, Refused)
        assert 'allowed: {"ask": "state"}' in str(long)
        assert len(str(long)) < 5000
        hall.server.cameras._answer = lambda question: "?" * 70_000
        (large,) = await asyncio.gather(
            asyncio.to_thread(ask_server, {"ask": "state"}, **where),
            return_exceptions=True,
        )
        assert "the answer has 70002 bytes" in str(large)


@pytest.fixture
def stand_in():
    """A server that answers each datagram by the function."""
    door = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    door.bind(("127.0.0.1", 0))
    door.settimeout(10.0)
    threads = []

    def serve(answers, count):
        def run():
            for _ in range(count):
                data, sender = door.recvfrom(65_536)
                for answer in answers(json.loads(data)):
                    door.sendto(answer, sender)

        threads.append(threading.Thread(target=run))
        threads[0].start()
        return door.getsockname()[1]

    yield serve
    threads[0].join()
    door.close()


def test_an_answer_that_comes_twice_is_not_taken_for_the_next_part(stand_in):
    def answers(question):
        after = question.get("after", -1)
        part = {
            "drones": {after + 1: {"x": after + 1}},
            **({"after": after} if after >= 0 else {}),
        }
        packed = json.dumps(part | ({"more": True} if after < 4 else {})).encode()
        return [packed, packed]

    found = ask_server({"ask": "state"}, port=stand_in(answers, 6), deadline=20.0)
    assert found == {"drones": {str(i): {"x": i} for i in range(6)}}


def test_what_answers_no_json_is_refused(stand_in):
    with pytest.raises(Refused, match="is not JSON"):
        ask_server(
            {"ask": "state"},
            port=stand_in(lambda question: [b"\x0c"], 1),
            deadline=20.0,
        )


def test_more_drones_than_the_cameras_see_are_refused():
    drones = [
        {
            "id": i,
            "home": [i % 30, i // 30, 0],
            "uri": f"udp://127.0.0.1:{20_000 + i}",
            "dongle": i % 16,
        }
        for i in range(451)
    ]
    fence = {"min": [-1.0, -1.0, 0.0], "max": [40.0, 40.0, 2.0]}
    config = SwarmConfig.of(
        {"name": "lab", "fence": fence, "graph": "path", "drones": drones}
    )
    with pytest.raises(ConfigError, match="451 drones"):
        select_from_swarm(config, None)


def test_a_body_that_cameras_see_is_not_hidden_by_a_drone_that_they_do_not_see():
    drones = [
        {
            "id": 0,
            "home": [0.0, 0.0, 0.0],
            "uri": "udp://127.0.0.1:19850",
            "body": "cf1",
        },
        {
            "id": 1,
            "home": [1.0, 0.0, 0.0],
            "uri": "udp://127.0.0.1:19851",
            "pose": "onboard",
        },
        {
            "id": 2,
            "home": [2.0, 0.0, 0.0],
            "uri": "udp://127.0.0.1:19852",
            "pose": "onboard",
        },
    ]
    config = SwarmConfig.of(
        {"name": "lab", "radio": {"log_rate": 25.0}, "drones": drones}
    )
    assert [seat.body for seat in select_from_swarm(config, ()).seats] == [
        "cf1",
        "",
        "cf2",
    ]
