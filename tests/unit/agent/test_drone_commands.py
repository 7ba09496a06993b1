"""The commands of operators at one drone, each by its verb."""

from types import SimpleNamespace

import pytest
from pilots import make_stand_in

from crazychoir.agent.drone_commands import DroneCommands
from crazychoir.agent.operator_commands import OperatorCommands
from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.errors import Refused
from crazychoir.runtime.clock import Clock
from crazychoir.safety.rules.modes import Mode


class StillClock(Clock):
    """A clock that moves only if a test moves it."""

    time_ns = 0

    def now_ns(self) -> int:
        return self.time_ns


class Beats:
    """Counts the reports of a console."""

    count = 0

    def note(self) -> None:
        self.count += 1


@pytest.fixture
def said():
    return []


@pytest.fixture
def beats():
    return Beats()


@pytest.fixture
def commands(said, beats):
    bus = Bus(StillClock(), Impairment(0))
    port = bus.port(3)
    port.publish = lambda topic, value: said.append((topic, value))
    pilot = make_stand_in(
        {
            "mode": Mode.HOVER,
            "cut": said.append,
            "permission.refuses": lambda _: "",
        }
    )
    drone = SimpleNamespace(id=3, port=port, pilot=pilot, guidance=object())
    orders = OperatorCommands(drone, None, said.append, lambda: "")
    return DroneCommands(drone, orders, beats.note)


async def test_queries_are_not_published(commands, said, beats):
    assert await commands.execute("ping", {}) == Mode.HOVER.value
    assert await commands.execute("watched", {}) is None
    assert beats.count == 1
    assert (await commands.execute("overview", {}))["route"] == []
    assert said == []


async def test_changes_are_published(commands, said):
    network = await commands.execute("impair", {"loss": 0.5})
    assert network["rules"] == [{"loss": 0.5}]
    assert said == [(DRONE_TOPICS.log, "drone 3: commanded: impair")]


async def test_stream_of_velocities_is_published_once(commands, said, monkeypatch):
    async def move(arguments):
        return "flown"

    monkeypatch.setitem(commands._changes, "velocity", move)
    clock = commands.drone.port.bus.clock
    for pause in (0, 100_000_000, 900_000_000, 1_000_000_000):
        clock.time_ns += pause
        await commands.execute("velocity", {})
    commands.stop(False)
    await commands.execute("velocity", {})
    words = [text.removeprefix("drone 3: commanded: ") for _, text in said]
    assert words == ["velocity", "velocity", "clear stop", "velocity"]


async def test_unknown_command_is_refused_with_the_list_of_commands(commands):
    allowed = (
        "arm, take-off, start, hold, go, land, home, go-to, velocity, load, fly, impair, param_set, "
        "firmware_set, task_add, task_cancel, param_get, firmware_get, firmware_list, task_list, overview, ping, "
        "watched"
    )
    with pytest.raises(Refused) as refused:
        await commands.execute("dance", {})
    assert refused.value.reason == f"no command 'dance'; there are {allowed}"


async def test_tasks_are_refused_before_the_mission(commands):
    with pytest.raises(Refused, match="its mission has not begun"):
        await commands.execute("task_list", {})


async def test_emergency_stop_cuts_the_motors(commands, said):
    commands.stop(False)
    assert [type(word) for word in said] == [tuple]
    commands.stop(True)
    assert said[-1] == "emergency stop"


class AnswersRequests:
    """A link to a body that notes what it is asked."""

    def __init__(self):
        self.asked = []

    async def request(self, verb, seconds, **arguments):
        self.asked.append((verb, arguments))
        return {"led.bitmask": 255.0}


async def test_parameters_of_the_firmware_are_asked_of_the_owner_of_its_dongle(
    commands, said
):
    commands.drone.remote = AnswersRequests()
    commands.drone.radio_watch = object()
    told = {"name": "led.bitmask", "value": 255.0}
    assert await commands.execute("firmware_set", told) == {"led.bitmask": 255.0}
    assert await commands.execute("firmware_get", {"name": "led"})
    assert commands.drone.remote.asked == [
        ("firmware_set", told),
        ("firmware_get", {"name": "led"}),
    ]
    assert said == [(DRONE_TOPICS.log, "drone 3: commanded: firmware_set")]


async def test_a_drone_without_a_radio_has_no_firmware(commands):
    commands.drone.remote = commands.drone.radio_watch = None
    with pytest.raises(Refused, match="drone 3: refused: it has no firmware here"):
        await commands.execute("firmware_get", {"name": "led"})
