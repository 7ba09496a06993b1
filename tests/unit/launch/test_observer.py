"""Requests of operators to a swarm: each drone that is there obeys at once, and the answer names every drone."""

import math
from dataclasses import dataclass, field
from functools import partial

import pytest

from crazychoir.bus.commands import ANSWER_TEXTS, CommandServer
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import ConfigError, Refused
from crazychoir.launch.emergency import OBEY_TIMEOUT
from crazychoir.launch.observer import (
    NEXT_PROCESS_TIMEOUT,
    NOT_READY_TIMEOUT,
    Window,
)
from crazychoir.runtime.clock import run_virtual


@dataclass
class Swarm:
    """Drones 0 to 2 beside an operator in virtual time; they obey, but for what a drone refuses."""

    clock: object
    stops: dict[int, list[tuple[float, bool]]] = field(default_factory=dict)
    verbs: list[tuple[int, str]] = field(default_factory=list)
    refuses: dict[int, float] = field(default_factory=dict)
    """Until when a drone is not ready."""
    slow: float = 0.0

    def __post_init__(self):
        self.bus = Bus(self.clock)
        self.bus.port(PORT_ADDRESSES.first_observer + 1)
        self.directory = {PORT_ADDRESSES.first_observer + 2: "another observer"}
        self.window = Window(self.clock, default_swarm(3), self)

    def comes(self, i, deaf=False):
        """Drone i is found; if deaf, it never answers."""
        self.directory[i] = "its process"
        if not deaf:
            CommandServer(
                self.bus.port(i), partial(self.execute, i), partial(self.stop, i)
            )

    async def execute(self, i, verb, arguments):
        """Obey, after `slow` s."""
        if self.clock.now() < self.refuses.get(i, 0.0):
            raise Refused(
                f"drone {i}", f"{ANSWER_TEXTS.not_ready}: waiting for the others"
            )
        self.verbs.append((i, verb))
        await self.clock.sleep(self.slow)
        return arguments or None

    def stop(self, i, on):
        self.stops.setdefault(i, []).append((self.clock.now(), on))


@pytest.fixture(autouse=True)
def no_other_runs(monkeypatch, tmp_path):
    """Hide other runs of this machine from the tests."""
    monkeypatch.setenv("CRAZYCHOIR_RUNTIME_DIR", str(tmp_path / "crazychoir"))


def play(scene):
    """Run `scene(swarm)`; returns the swarm, what came of it, and the seconds that it took."""

    async def main(clock):
        swarm = Swarm(clock)
        began = clock.now()
        said = await scene(swarm)
        return swarm, said, clock.now() - began

    return run_virtual(main)


def test_a_stop_does_not_wait_once_all_drones_have_answered():
    async def scene(swarm):
        for i in range(3):
            swarm.comes(i)
        return await swarm.window.emergency_stop(clear=False)

    swarm, said, seconds = play(scene)
    assert said == dict.fromkeys(range(3), (True, "acknowledged"))
    assert seconds < 0.2
    assert {i: [on for _, on in stops] for i, stops in swarm.stops.items()} == {
        0: [True],
        1: [True],
        2: [True],
    }


def test_an_absent_drone_is_named_and_does_not_delay_the_others():
    async def scene(swarm):
        swarm.comes(0)
        swarm.clock.call_at(int(1e9), partial(swarm.comes, 2))
        return await swarm.window.emergency_stop(clear=False)

    swarm, said, seconds = play(scene)
    assert said == {
        0: (True, "acknowledged"),
        1: (False, "absent"),
        2: (True, "acknowledged"),
    }
    assert swarm.stops[0][0][0] == pytest.approx(0.0, abs=0.02), (
        "before the other drones are found"
    )
    assert swarm.stops[2][0][0] == pytest.approx(1.0, abs=0.15)
    assert seconds == pytest.approx(1.0 + NEXT_PROCESS_TIMEOUT, abs=0.1), (
        "after the last drone was found"
    )


def test_a_drone_that_is_there_and_does_not_answer_is_not_absent():
    async def scene(swarm):
        for i in range(3):
            swarm.comes(i, deaf=i == 1)
        return await swarm.window.emergency_stop(
            clear=True
        ), await swarm.window.request("land")

    swarm, (cleared, landed), seconds = play(scene)
    assert cleared[1] == (False, "no acknowledgement")
    assert cleared[0] == (True, "acknowledged")
    assert [on for _, on in swarm.stops[0]] == [False]
    assert landed[1][0] is False
    assert "drone 1: no answer to 'land' within 5 s" in landed[1][1]
    assert 10.0 < seconds < 16.0


def test_a_drone_that_refuses_says_why():
    async def scene(swarm):
        swarm.refuses = {2: math.inf}
        for i in range(3):
            swarm.comes(i)
        return await swarm.window.request("land"), await swarm.window.request(
            "impair", loss=0.3
        )

    swarm, (landed, impaired), seconds = play(scene)
    not_now = f"refused: {ANSWER_TEXTS.not_ready}: waiting for the others"
    assert landed == {
        0: (True, "acknowledged"),
        1: (True, "acknowledged"),
        2: (False, not_now),
    }
    assert impaired[0] == (True, {"loss": 0.3})
    assert swarm.verbs == [(0, "land"), (1, "land"), (0, "impair"), (1, "impair")]
    assert seconds < 0.2


@pytest.mark.parametrize("owner", [True, False])
def test_bodies_in_the_world_of_an_owner_are_stopped_by_themselves(owner):
    async def scene(swarm):
        with_owner(swarm, (0, 1) if owner else ())
        swarm.comes(0)
        return await swarm.window.emergency_stop(clear=False)

    swarm, said, _ = play(scene)
    if owner:
        assert said == {
            0: (True, "acknowledged"),
            1: (False, "absent; its body has obeyed"),
        }
        assert [
            at for i in (0, 1) for at, _ in swarm.stops[PORT_ADDRESSES.body_offset + i]
        ] == pytest.approx([0.0, 0.0], abs=0.02)
    else:
        silent = "the owner of its body does not answer"
        assert said == {
            0: (False, f"acknowledged; {silent}"),
            1: (False, f"absent; {silent}"),
        }


def test_without_any_agent_there_is_no_swarm():
    async def scene(swarm):
        began = swarm.clock.now()
        with pytest.raises(
            Refused,
            match=r"no swarm of yours runs here: start one .*crazychoir run.*--swarm FILE",
        ):
            await swarm.window.order("hold", None, 5.0)
        swarm.window.option = "lab.toml"
        with pytest.raises(
            Refused, match=r"no agent found at tcp/127.0.0.1:7460 .*is it running"
        ):
            await swarm.window.emergency_stop(clear=False)
        return swarm.clock.now() - began

    _, seconds, _ = play(scene)
    assert seconds == pytest.approx(2.0 * NEXT_PROCESS_TIMEOUT, abs=0.1)


def with_owner(swarm, bodies=(0, 1)):
    """The bodies of two drones are in the world of an owner, which answers for these."""
    drones = [{"id": i, "home": [float(i), 0.0, 0.0]} for i in range(2)]
    swarm.window.config = SwarmConfig.of(
        {"name": "a", "drones": drones, "world": {"owned": True}}
    )
    for i in bodies:
        CommandServer(
            swarm.bus.port(PORT_ADDRESSES.body_offset + i),
            swarm.execute,
            partial(swarm.stop, PORT_ADDRESSES.body_offset + i),
        )


@pytest.mark.parametrize("patience", [0.0, NEXT_PROCESS_TIMEOUT, 30.0])
def test_what_the_bodies_have_answered_is_said_though_no_agent_is_there(
    patience, caplog
):
    async def scene(swarm):
        with_owner(swarm)
        swarm.window.patience = patience
        return await swarm.window.emergency_stop(clear=False)

    swarm, said, seconds = play(scene)
    assert said == dict.fromkeys(range(2), (False, "absent; its body has obeyed"))
    assert [
        on for i in range(2) for _, on in swarm.stops[PORT_ADDRESSES.body_offset + i]
    ] == [True, True]
    assert seconds == pytest.approx(NEXT_PROCESS_TIMEOUT, abs=0.2), (
        "agents get no longer, though a run may be starting"
    )
    assert caplog.messages == [
        "swarm a: stopped: bodies 0 to 1; waiting for the others"
    ]


def test_an_agent_that_hangs_is_not_waited_for_once_its_body_has_obeyed():
    async def scene(swarm, bodies):
        with_owner(swarm, bodies)
        swarm.comes(0)
        swarm.comes(1, deaf=True)
        return await swarm.window.emergency_stop(clear=False)

    _, said, seconds = play(partial(scene, bodies=(0, 1)))
    assert said == {
        0: (True, "acknowledged"),
        1: (False, "no acknowledgement; its body has obeyed"),
    }
    assert seconds == pytest.approx(NEXT_PROCESS_TIMEOUT, abs=0.2)
    _, said, seconds = play(partial(scene, bodies=(0,)))
    assert said[1] == (
        False,
        "no acknowledgement; the owner of its body does not answer",
    )
    assert seconds == pytest.approx(OBEY_TIMEOUT, abs=0.2), "nothing has stopped it yet"


def test_a_world_that_is_gone_is_not_waited_for_as_a_run_that_is_starting(caplog):
    async def scene(swarm):
        with_owner(swarm, bodies=())
        swarm.window.patience = 30.0
        for i in range(2):
            swarm.comes(i)
        return await swarm.window.emergency_stop(clear=False)

    _, said, seconds = play(scene)
    assert said == dict.fromkeys(
        range(2), (False, "acknowledged; the owner of its body does not answer")
    )
    assert seconds == pytest.approx(NEXT_PROCESS_TIMEOUT, abs=0.2)
    assert caplog.messages == [
        "swarm a: stopped: agents 0 to 1; waiting for the others"
    ], "at once"


def test_a_stop_waits_for_a_run_that_is_starting_with_words(caplog):
    async def scene(swarm):
        swarm.window.patience = 30.0
        swarm.clock.call_at(int(18e9), partial(swarm.comes, 1))
        return await swarm.window.emergency_stop(clear=True)

    _, said, seconds = play(scene)
    assert said == {
        0: (False, "absent"),
        1: (True, "acknowledged"),
        2: (False, "absent"),
    }
    assert seconds == pytest.approx(18.0 + NEXT_PROCESS_TIMEOUT, abs=0.2)
    assert caplog.messages == [
        "swarm default is starting: waiting for its drones, up to 30 s",
        "swarm default: cleared: agents 1; waiting for the others",
    ]


def test_an_order_waits_for_a_swarm_that_is_starting(caplog):
    async def scene(swarm):
        swarm.window.patience = 30.0
        swarm.refuses = {1: swarm.clock.now() + 25.0}
        for i in range(3):
            swarm.clock.call_at(int((18.0 + i) * 1e9), partial(swarm.comes, i))
        return await swarm.window.order("take-off", None, 10.0)

    swarm, said, seconds = play(scene)
    assert {i: answer[1][0] for i, answer in said.items()} == dict.fromkeys(
        range(3), "done"
    )
    assert seconds == pytest.approx(25.0, abs=0.5), "drone 1 was not ready before"
    assert sorted(swarm.verbs) == [(i, "take-off") for i in range(3)]
    assert caplog.messages == [
        "swarm default is starting: waiting for its drones, up to 30 s"
    ]


def test_a_drone_that_does_not_get_ready_says_so_in_time():
    async def scene(swarm):
        swarm.refuses = {1: math.inf}
        for i in range(3):
            swarm.comes(i)
        return await swarm.window.order("take-off", None, 30.0)

    _, said, seconds = play(scene)
    assert said[1] == (False, ("refused", "it is not ready: waiting for the others"))
    assert seconds == pytest.approx(NOT_READY_TIMEOUT, abs=0.5)


def test_what_is_not_done_in_time_names_the_time_that_was_given():
    async def scene(swarm):
        swarm.refuses, swarm.slow = {1: swarm.clock.now() + 2.7}, 60.0
        for i in range(3):
            swarm.comes(i)
        return await swarm.window.order("land", None, 30.0)

    _, said, seconds = play(scene)
    assert said == dict.fromkeys(
        range(3), (False, ("accepted", "not done within 30 s"))
    ), "drone 1 was asked again"
    assert seconds == pytest.approx(30.0, abs=0.1)


def test_unknown_drones_are_refused_before_any_drone_is_asked():
    async def scene(swarm):
        swarm.window.check("--edge", (0, 2))
        with pytest.raises(ConfigError, match="--edge: found drone 9; allowed: 0 to 2"):
            swarm.window.check("--edge", (1, 9))

    play(scene)


def test_reading_gives_values_with_their_age():
    async def scene(swarm):
        from crazychoir.bus.topics import DRONE_TOPICS
        from crazychoir.types import Status

        swarm.comes(0)
        heard = []
        box = swarm.window.read(
            DRONE_TOPICS.status, 0, lambda value, age: heard.append((value.phase, age))
        )
        swarm.bus.ports[0].publish(DRONE_TOPICS.status, Status("hovering"), 0.1)
        return box.received, heard

    _, (received, heard), _ = play(scene)
    assert received == 1
    assert heard == [("hovering", 0.1)]


@pytest.mark.parametrize(
    "work",
    [
        lambda window: window.request("ping"),
        lambda window: window.order("land", None, 5.0),
        lambda window: window.emergency_stop(clear=False),
    ],
)
def test_from_a_host_that_is_no_operator_nothing_is_commanded_and_the_reason_is_said_at_once(
    work,
):
    async def scene(swarm):
        drones = [
            {"id": i, "home": [1.0 * i, 0.0, 0.0], "host": "ab"[i]} for i in range(2)
        ]
        hosts, security = (
            {"a": "10.0.0.1", "b": "10.0.0.2"},
            {"operators": ["console", "a"]},
        )
        swarm.window.config = SwarmConfig.of(
            {"name": "s", "drones": drones, "hosts": hosts, "security": security}
        )
        swarm.bus.host = "b"
        with pytest.raises(
            Refused, match=r"are those of b: drones obey and answer only console, a"
        ):
            await work(swarm.window)
        swarm.bus.host = "console"
        with pytest.raises(Refused, match="no swarm of yours runs here"):
            await work(swarm.window)

    play(scene)
