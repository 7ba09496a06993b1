"""References, goals and paths in flight: taken, or refused with the reason before anything moves."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.agent.agent import Agent
from crazychoir.agent.command_arguments import path_message
from crazychoir.agent.sketch import flight_messages, plan_sketch
from crazychoir.bus.commands import ANSWER_TEXTS, Commander
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.config.flight_room import ABOVE_FLOOR, flight_room
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.planning.drawing.drawing import Pen
from crazychoir.planning.spline import fit_spline
from crazychoir.runtime.clock import run_virtual
from crazychoir.safety.rules.guard import EDGE_MARGIN, FENCE_INSET, Action, Fence, Guard
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import Acceleration, FullState, Goto, State, Velocity

FENCE = {"min": [-2.0, -2.0, 0.0], "max": [2.0, 2.0, 2.0]}
FLIGHT = {
    "takeoff_height": 0.5,
    "speed_limit": 2.0,
    "acceleration_limit": 4.0,
    "landing_speed": 0.6,
}
READ_ONLY = np.zeros(3)
READ_ONLY.flags.writeable = False
NAN, INF = float("nan"), float("inf")


def config_of(uri="sim://", fence=FENCE, **flight):
    drones = [{"id": 0, "home": [0.0, 0.0, 0.0], "uri": uri}]
    return SwarmConfig.of(
        {
            "name": "a",
            "graph": "empty",
            "drones": drones,
            "flight": FLIGHT | flight,
            "fence": fence,
        }
    )


def fly(guidance, config=None, scene=None):
    """The result of a flight of one drone; its guidance, and how far it was from its home, at most, in the plane."""
    config = config or config_of()

    async def main(clock):
        agent = Agent(
            clock, config, SimpleNamespace(guidance=lambda i, config: guidance), (0,)
        )
        flying = asyncio.create_task(agent.run())
        if scene is not None:
            await scene(
                agent, Commander(agent.bus.port(PORT_ADDRESSES.first_observer, 0xF1))
            )
        async with asyncio.timeout(300.0):
            return (await flying)[0]

    return run_virtual(main)


# References ----------------------------------------------------------------------------------------------------------


class Law(CFDistributedFeedback):
    """Returns the same thing in each of its steps."""

    duration, rate = 1.0, 50.0

    def __init__(self, reference):
        self.reference = reference

    def step(self, me, heard):
        return self.reference(me) if callable(self.reference) else self.reference


ODD = {
    "whole numbers": Acceleration(np.array([0, 0, 1])),
    "a list": Acceleration([0, 0, 1]),
    "float32": Acceleration(np.zeros(3, dtype=np.float32), np.float32(0.5)),
    "truth values": Acceleration(np.zeros(3, dtype=bool)),
    "objects": Velocity(np.array([0, 0.1, 0], dtype=object)),
    "a whole velocity": Velocity((0, 0, 0), np.int64(1)),
    "not contiguous": Acceleration(np.zeros(6)[::2]),
    "read-only": Acceleration(READ_ONLY),
    "a whole full state": FullState(np.array([0, 0, 1, *[0] * 11])),
    "a full state in a list": FullState([0, 0, 1, *[0] * 11]),
    "a whole place": Goto([0, 0, 1]),
    "beyond the limits": Acceleration(np.array([0, 9, 0])),
}


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize("uri", ["sim://", "sim://motors"])
def test_a_law_may_return_numbers_of_any_type(name, uri):
    result = fly(Law(ODD[name]), config_of(uri))
    assert result["success"], result
    assert result["references"] >= 49


@pytest.mark.parametrize(
    ("reference", "uri"),
    [
        (Velocity(np.array([0, 0, 0])), "sim://single"),
        (Velocity([0, 0, 0], 1), "sim://unicycle"),
        (Acceleration(np.array([0, 0, 0])), "sim://double"),
        (Goto(np.array([1, 0, 0])), "sim://unicycle"),
    ],
)
def test_a_robot_that_drives_takes_whole_numbers_too(reference, uri):
    result = fly(Law(reference), config_of(uri))
    assert result["success"], result


@pytest.mark.parametrize(
    ("reference", "found"),
    [
        (
            Acceleration(np.array([0, 1])),
            "Acceleration.a: found int64 array of shape (2,)",
        ),
        (Acceleration(np.zeros((3, 1))), "found float64 array of shape (3, 1)"),
        (Acceleration(np.array([0, 1j, 0])), "found complex128 array of shape (3,)"),
        (Acceleration(["0", "0", "1"]), "Acceleration.a: found list ['0', '0', '1']"),
        (Acceleration(np.zeros(3), None), "Acceleration.yaw: found NoneType None"),
        (Velocity([0.0, NAN, 0.0]), "Velocity.v: found list [0.0, nan, 0.0]"),
        (FullState(np.zeros(13)), "FullState.flat: found float64 array of shape (13,)"),
        (Goto(None), "Goto.p: found NoneType None"),
        (np.array([0, 0, 1]), "found int64 array of shape (3,)"),
        (
            Goto([0.0, 0.0, 0.0]),
            "Goto = [0.0, 0.0, 0.0]: outside the fence, at its edge, or on the floor",
        ),
        (Goto([9, 0, 1]), "Goto = [9.0, 0.0, 1.0]: outside the fence"),
    ],
)
def test_what_cannot_be_flown_is_refused_with_file_line_type_and_shape_and_the_drone_hovers_then_lands(
    reference, found
):
    places = []
    result = fly(Law(lambda me: (places.append(me.p.copy()), reference)[1]))
    assert (result["success"], result["references"]) == (False, 0)
    assert found in result["reason"]
    assert (
        f"({__file__}:{Law.step.__code__.co_firstlineno} Law.step)" in result["reason"]
    )
    assert np.ptp(places, axis=0).max() < 0.01, "it hovers"
    assert result["place"] == pytest.approx([0.0, 0.0, 0.5], abs=0.02)


def test_a_law_that_begins_to_return_nonsense_brakes_and_lands_by_the_safety_table():
    law = Law(
        lambda me: (
            Acceleration([0.1, 0, 0])
            if law._running.tally.steps < 20
            else Acceleration(np.array(["x"] * 3))
        )
    )
    law.duration = 10.0
    modes = []

    async def scene(agent, commander):
        async for _ in agent.clock.ticks(10.0):
            modes.append(agent.drones[0].pilot.mode)
            if modes[-1] is Mode.GROUND and Mode.LAND in modes:
                return

    result = fly(law, scene=scene)
    assert not result["success"]
    assert "reference" in result["reason"]
    assert Mode.CUT not in modes


def test_a_mission_that_follows_nonsense_is_told_file_and_line_once(caplog):
    class Follows(CFGuidance):
        async def mission(self):
            await self.take_off()
            for _ in range(20):
                self.follow(Acceleration(np.array([1j, 0, 0])))
                await self.sleep(0.02)
            await self.land()

    assert fly(Follows())["success"]
    told = [line for line in caplog.messages if f"{__file__}:" in line]
    assert len(told) == 1
    assert "follow(): Acceleration.a: found complex128 array of shape (3,)" in told[0]


class Whole:
    """A trajectory of a user's class, of whole numbers."""

    duration = 1

    def __init__(self, flat=(0, 0, 1, *[0] * 11)):
        self.flat = flat

    def sample(self, t):
        return FullState(np.array(self.flat))

    def done(self, t):
        return t >= self.duration


class Flies(CFGuidance):
    """Flies to a goal, or along a path, and says where it was when it was refused."""

    def __init__(self, verb, *arguments, **options):
        self.verb, self.arguments, self.options = verb, arguments, options

    async def mission(self):
        await self.take_off()
        before, began = self.state.p.copy(), self.member.clock.now()
        try:
            await getattr(self, self.verb)(*self.arguments, **self.options)
        except ConfigError as error:
            pilot = self.member.pilot
            await self.sleep(1.0)
            still = (
                bool(np.linalg.norm(self.state.p - before) < 0.01)
                and pilot.mode is Mode.HOVER
            )
            return {
                "refused": str(error),
                "still": still,
                "at_once": self.member.clock.now() - began < 1.01,
            }
        finally:
            await self.land()
        return {"refused": ""}


def test_a_trajectory_of_whole_numbers_is_flown():
    assert fly(Flies("fly", Whole())) == {"success": True, "refused": ""}


# Goals and paths -----------------------------------------------------------------------------------------------------


HIGHEST = FENCE["max"][2]
OUTSIDE = {
    "below the floor": [0.0, 0.0, -1.0],
    "on the floor": [0.0, 0.0, 0.0],
    "just above the floor": [0.0, 0.0, ABOVE_FLOOR - 0.01],
    "above the fence": [0.0, 0.0, 50.0],
    "at the top of the fence": [0.0, 0.0, HIGHEST],
    "at a side of the fence": [2.0, 0.0, 1.0],
    "at an edge of the fence": [-2.0, 2.0, 1.0],
    "beside the fence": [0.0, -2.001, 1.0],
}
NO_PLACE = {
    "nan": [0.0, NAN, 1.0],
    "inf": [INF, 0.0, 1.0],
    "two numbers": [0.0, 1.0],
    "a text": "1,0,1",
    "nothing": None,
    "texts": ["1", "0", "1"],
    "a matrix": [[0.0, 0.0, 1.0]],
}
INSIDE = {
    "as low as a take-off": [0.0, 0.0, ABOVE_FLOOR],
    "as high as it may be": [0.0, 0.0, HIGHEST - EDGE_MARGIN],
    "in a corner": [2.0 - EDGE_MARGIN, EDGE_MARGIN - 2.0, 1.0],
    "whole numbers": np.array([1, 0, 1]),
    "a tuple": (0.5, 0, 1),
}


@pytest.mark.parametrize("name", [*OUTSIDE, *NO_PLACE])
def test_a_goal_that_the_guard_would_brake_at_is_refused_before_the_drone_moves(name):
    result = fly(Flies("go_to", (OUTSIDE | NO_PLACE)[name]))
    assert (result["still"], result["at_once"]) == (True, True)
    assert result["refused"].startswith("drone 0: go_to()")
    assert ("outside the fence" in result["refused"]) == (name in OUTSIDE)


@pytest.mark.parametrize("name", INSIDE)
def test_a_goal_inside_is_flown_to(name):
    assert fly(Flies("go_to", INSIDE[name])) == {"success": True, "refused": ""}


@pytest.mark.parametrize(
    "options", [{"yaw": NAN}, {"yaw": "north"}, {"duration": NAN}, {"duration": INF}]
)
def test_a_goal_without_a_yaw_or_a_duration_that_are_numbers_is_refused(options):
    result = fly(Flies("go_to", [0.5, 0.0, 1.0], **options))
    assert result["still"]
    assert f"go_to(): {next(iter(options))}: found" in result["refused"]


def way(*places, seconds=8.0):
    return fit_spline(
        np.linspace(0.0, seconds, len(places)), np.array(places, dtype=float), degree=7
    )


PATHS = {
    "on the floor": way((0, 0, 0.0), (0.5, 0, 0.0), (1, 0, 0.0)),
    "that dips to the floor": way(
        (0, 0, 1.0), (0.5, 0, 0.05), (1, 0, 1.0), seconds=20.0
    ),
    "along the top of the fence": way((0, 0, HIGHEST), (1, 0, HIGHEST)),
    "that overshoots the fence between places inside": way(
        (1.9, 1.9, 1), (1.98, 0.6, 1), (1.99, 0.0, 1), (0, -1.9, 1), seconds=30.0
    ),
    "that ends outside": way((0, 0, 1), (2.5, 0, 1), seconds=20.0),
    "of a yaw that is no number": Whole((0, 0, 1, *[0] * 9, NAN, 0)),
    "of too few numbers": Whole((0, 0, 1)),
    "of texts": Whole(["0"] * 14),
}


@pytest.mark.parametrize("name", PATHS)
def test_a_path_that_the_guard_would_brake_on_is_refused_before_the_drone_moves(name):
    result = fly(Flies("fly", PATHS[name]))
    assert (result["still"], result["at_once"]) == (True, True), result
    assert "trajectory" in result["refused"] or "fly()" in result["refused"]


@pytest.mark.parametrize("duration", [NAN, INF, 0.0, -1.0, "1", None])
def test_a_path_without_a_duration_is_refused(duration):
    path = Whole()
    path.duration = duration
    result = fly(Flies("fly", path))
    assert result["still"]
    assert (
        "fly(): duration: found" in result["refused"]
        or "set-points" in result["refused"]
    )


def test_what_is_inside_the_room_the_guard_never_brakes_and_what_it_brakes_is_outside():
    """One measure for both: of places inside and outside, at rest and in every direction."""
    draw = np.random.default_rng(3)
    fence = Fence.box((-2.0, -1.0, 0.0), (1.0, 2.0, 2.0))
    guard = Guard(fence, ground=0.0)
    for place in draw.uniform((-2.2, -1.2, -0.2), (1.2, 2.2, 2.2), (500, 3)):
        path = np.zeros((1, 14))
        path[0, 0:3] = place
        is_inside = bool(guard.leaves_room(path)[0] <= 0.0)
        verdict = Guard(fence, ground=0.0).check(0.0, State.at(place), 0.0)
        assert is_inside <= (verdict.action is Action.NOMINAL)
        assert is_inside == (guard.room.outside(*place) <= 0.0)
    assert guard.room == Fence(*flight_room(fence.low, fence.high, 0.0))
    assert guard.room.low[2] == FENCE_INSET, "as low as a take-off ends"


def test_a_robot_that_drives_may_be_sent_along_the_floor():
    assert (
        fly(Flies("go_to", [1.0, 0.5, 0.0]), config_of("sim://unicycle"))["refused"]
        == ""
    )
    assert (
        "outside"
        in fly(Flies("go_to", [2.0, 0.5, 0.0]), config_of("sim://unicycle"))["refused"]
    )


def test_a_floor_of_the_fence_above_the_ground_counts():
    high = config_of(
        fence={"min": [-2.0, -2.0, -0.0], "max": [2.0, 2.0, 2.0]}, ground=-0.5
    )
    assert fly(Flies("go_to", [0.0, 0.0, 0.01]), high)["refused"] == ""


class Waits(CFGuidance):
    async def mission(self):
        await self.take_off()
        await self.sleep(60.0)
        await self.land()


def test_an_operators_goals_and_paths_are_refused_before_the_drone_moves():
    heard = {}

    async def scene(agent, commander):
        await agent.clock.sleep(6.0)
        pilot = agent.drones[0].pilot
        await commander.request(0, "hold", 5.0)
        before, began = pilot.state.p.copy(), agent.clock.now()
        asked = {name: ("go-to", {"p": p}) for name, p in (OUTSIDE | NO_PLACE).items()}
        asked |= {
            f"{key} {x}": ("go-to", {"p": [0.5, 0, 1], key: x})
            for key in ("yaw", "duration")
            for x in (NAN, INF)
        }
        asked |= {
            name: ("fly", path_message(path))
            for name, path in PATHS.items()
            if not isinstance(path, Whole)
        }
        for name, (verb, arguments) in asked.items():
            heard[name] = await commander.request(0, verb, 60.0, **arguments)
        assert agent.clock.now() - began < 2.0
        await agent.clock.sleep(1.0)
        assert pilot.state.p == pytest.approx(before, abs=0.01)
        assert pilot.mode is Mode.HOVER
        await commander.request(0, "land", 60.0)

    fly(Waits(), scene=scene)
    assert {answer.kind for answer in heard.values()} == {ANSWER_TEXTS.refused}
    for name in OUTSIDE:
        assert "outside the fence" in heard[name].detail


@pytest.mark.parametrize("height", [0.0, 0.05, HIGHEST - 0.001])
def test_a_drawing_on_the_floor_or_at_the_top_of_the_fence_is_refused(height):
    stroke = [(0.1 * k, 0.05 * k, 0.0) for k in range(20)]
    with pytest.raises(ConfigError, match="fence"):
        plan_sketch([stroke], Pen(height=height), config_of())
    path = plan_sketch([stroke], Pen(height=1.0), config_of()).path
    with pytest.raises(ConfigError, match="path of drone 0"):
        flight_messages(
            path,
            (0,),
            (0.0, 0.0, 0.0),
            config_of(fence={"min": [-2, -2, 0], "max": [0.95, 2, 2]}),
        )


@pytest.mark.parametrize(
    ("home", "words"),
    [
        ([2.0, 0.0, 0.0], "nearer than 0.005 m"),
        ([0.0, 0.0, 2.0], "nearer than 0.005 m"),
        ([2.1, 0, 0], "outside"),
        ([0, 0, -0.1], "outside"),
        ([NAN, 0, 0], "home"),
        ([INF, 0, 0], "home"),
    ],
)
def test_a_start_from_where_no_drone_can_rise_is_refused_with_the_key(home, words):
    raw = {
        "name": "a",
        "graph": "empty",
        "drones": [{"id": 0, "home": home}],
        "fence": FENCE,
    }
    with pytest.raises(
        ConfigError, match=rf"drones\[0\]\.home.*{words}|drones\[0\]\.home"
    ):
        SwarmConfig.of(raw)
