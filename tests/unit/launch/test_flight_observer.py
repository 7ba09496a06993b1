"""What an observer makes of a swarm."""

import asyncio
import contextlib

import numpy as np
import pytest

from crazychoir.agent.drone import WAITING_TASK
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.guidance.feedback import LAW_TASK
from crazychoir.launch import flight_observer as scores
from crazychoir.launch.flight_observer import SCORE_LIMITS, FlightScore
from crazychoir.runtime.clock import run_virtual
from crazychoir.types import State, Status

PERIOD = 1.0 / DRONE_TOPICS.truth.rate
STEP = 1.5
"""Periods that one look takes."""


class Sky:
    """Ports of drones without programs, and their score; a test publishes their truth and status."""

    def __init__(self, clock, n=2, goal=None, unseen=()):
        self.clock = clock
        self.bus = Bus(clock)
        self.ports = [self.bus.port(i) for i in range(n)]
        self.score = FlightScore(self.bus, tuple(range(n)), goal or {}, unseen=unseen)

    def at(self, i, p, v=(0.0, 0.0, 0.0), age=0.0):
        self.ports[i].publish(DRONE_TOPICS.truth, State.at(p, v), age)

    def tells(self, i, phase, task=""):
        self.ports[i].publish(DRONE_TOPICS.status, Status(phase, task))

    async def looks(self, times=1):
        """The score looks so many times, and half a period goes by."""
        running = asyncio.create_task(self.score.run())
        await self.clock.sleep((times + 0.5) * PERIOD)
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running


def seen(scene, **options):
    """The score after `scene(sky)` in virtual time."""

    async def main(clock):
        sky = Sky(clock, **options)
        await scene(sky)
        return sky.score

    return run_virtual(main)


def test_nothing_is_measured_before_everybody_was_seen():
    async def scene(sky):
        sky.at(0, (0, 0, 0))
        await sky.looks(3)

    score = seen(scene)
    assert score.min_separation == float("inf")
    assert score.formation() == {}


def test_the_smallest_distance_of_any_two_stays():
    async def scene(sky):
        for x in (3.0, 0.5, 2.0):
            sky.at(0, (0, 0, 0))
            sky.at(1, (5.0, 0, 0))
            sky.at(2, (x, 0, 0))
            await sky.looks()

    assert seen(scene, n=3).min_separation == pytest.approx(0.5)


def test_a_distance_is_between_places_at_one_time():
    """One truth is 0.05 s old when it comes, of a drone that has flown on at 1 m/s since."""

    async def scene(sky):
        sky.at(0, (0, 0, 0))
        sky.at(1, (1.0, 0, 0), (-1.0, 0, 0), age=0.05)
        await sky.looks()

    assert seen(scene).min_separation == pytest.approx(1.0 - 0.05 - PERIOD)


def test_places_that_are_old_are_not_compared():
    """The truth of drone 1 is 0.2 s old: its present place is unknown."""

    async def scene(sky):
        sky.at(0, (0, 0, 0))
        sky.at(1, (0.1, 0, 0), age=0.2)
        sky.at(2, (0.7, 0, 0))
        await sky.looks()

    score = seen(scene, n=3)
    assert score.min_separation == pytest.approx(0.7)
    assert score.touching == {}


def test_pairs_that_come_near_enough_to_touch_are_told_with_their_least_distance():
    async def scene(sky):
        for x in (
            0.5,
            SWARM_LIMITS.touching_distance - 0.01,
            SWARM_LIMITS.touching_distance - 0.03,
            0.5,
            SWARM_LIMITS.touching_distance + 0.01,
        ):
            sky.at(0, (0, 0, 0))
            sky.at(1, (5.0, 0, 0))
            sky.at(2, (x, 0, 0))
            await sky.looks()

    assert seen(scene, n=3).touching == {
        (0, 2): pytest.approx(SWARM_LIMITS.touching_distance - 0.03)
    }


def test_one_drone_is_never_near_another():
    async def scene(sky):
        sky.at(0, (0, 0, 0))
        await sky.looks()

    assert seen(scene, n=1).min_separation == float("inf")


def test_lengths_flown_add_up():
    async def scene(sky):
        for p in ((0, 0, 0), (0, 0, 1), (3, 4, 1), (0, 0, 1)):
            sky.at(0, p)

    assert seen(scene).flown == {0: pytest.approx(11.0), 1: 0.0}


def test_a_formation_is_judged_from_the_first_law_to_the_first_landing():
    async def scene(sky):
        for far, phase, task in (
            (5.0, "taking off", ""),
            (2.0, "mission", LAW_TASK),
            (1.0, "mission", LAW_TASK),
            (0.001, "mission", LAW_TASK),
            (9.0, "landing", "landing"),
        ):
            sky.tells(0, phase, task)
            sky.at(0, (far, 0, 0))
            sky.at(1, (0, 1, 0))
            await sky.looks()

    found = seen(scene, goal={0: np.zeros(3), 1: np.array([0.0, 1.0, 0.0])}).formation()
    assert found["formation_error_m"] == pytest.approx(0.001)
    assert found["settling_s"] == pytest.approx((STEP + 1.0) * PERIOD)


@pytest.mark.parametrize(
    ("phase", "task"),
    [("on ground", LAW_TASK), ("hovering", "waiting"), ("landing", "landing")],
)
def test_a_drone_that_flies_no_law_forms_nothing(phase, task):
    async def scene(sky):
        sky.tells(0, phase, task)
        sky.at(0, (1, 0, 0))
        sky.at(1, (0, 1, 0))
        await sky.looks(2)

    assert seen(scene, goal={0: np.zeros(3)}).formation() == {}


def test_a_score_does_not_grow_with_the_flight():
    async def scene(sky):
        sky.tells(0, "mission", LAW_TASK)
        for n in range(300):
            sky.at(
                0,
                (2.0 * SCORE_LIMITS.settled_distance * (n % 3 == 0 and n < 200), 0, 0),
            )
            sky.at(1, (1, 1, 0))
            sky.ports[0].publish(DRONE_TOPICS.log, f"line {n}")
            await sky.looks()
        sky.score.log.extend(
            str(n) for n in range(2 * scores.SCORE_LIMITS.most_log_lines)
        )

    score = seen(scene, goal={0: np.zeros(3)})
    assert len(score.errors) == 2
    assert score.formation()["settling_s"] == pytest.approx(
        (198 * STEP + 1.0) * PERIOD
    ), "the last time"
    assert score.formation()["formation_error_m"] == 0.0
    assert len(score.log) == scores.SCORE_LIMITS.most_log_lines
    assert score.log[-1] == str(2 * scores.SCORE_LIMITS.most_log_lines - 1), (
        "the newest stay"
    )


def test_it_hears_when_the_first_drone_has_begun():
    async def scene(sky):
        sky.tells(0, "on ground", WAITING_TASK)
        assert sky.score.go_at is None
        await sky.clock.sleep(3.0)
        for task in ("planning", LAW_TASK):
            sky.tells(1, "on ground", task)
            await sky.clock.sleep(1.0)

    assert seen(scene).go_at == pytest.approx(3.0)


def test_drones_that_never_took_off_have_flown_nothing_and_come_near_no_other():
    async def scene(sky, phase):
        for x in (0.0, 8.0):  # their estimates drift
            for i in range(2):
                sky.tells(i, "on ground", WAITING_TASK)
                sky.at(i, (x, 0.01 * i, 0))
            sky.tells(2, phase)
            sky.at(2, (x, 0.5, 0))
            await sky.looks()

    standing = seen(lambda sky: scene(sky, "on ground"), n=3, unseen=(0, 1, 2))
    assert standing.flown == {0: 0.0, 1: 0.0, 2: 0.0}
    assert (standing.min_separation, standing.touching) == (float("inf"), {})
    carried = seen(lambda sky: scene(sky, "on ground"), n=3, unseen=(0, 1))
    assert carried.flown == {0: 0.0, 1: 0.0, 2: pytest.approx(8.0)}, (
        "cameras see it, or a recording has"
    )
    one_flies = seen(lambda sky: scene(sky, "taking off"), n=3, unseen=(0, 1, 2))
    assert one_flies.flown == {0: 0.0, 1: 0.0, 2: pytest.approx(8.0)}
    assert one_flies.min_separation == pytest.approx(0.49)
    assert one_flies.touching == {}


def test_a_landed_drone_has_flown_as_far_as_before():
    async def scene(sky):
        for phase, x in (("on ground", 0.0), ("mission", 3.0), ("on ground", 3.0)):
            sky.tells(0, phase)
            sky.at(0, (x, 0, 0))
            await sky.looks()

    assert seen(scene, n=1).flown == {0: pytest.approx(3.0)}


class Room:
    """True states of drones of this process; a test moves them."""

    def __init__(self, *ids):
        self.ids = ids
        self.states = np.zeros((len(ids), 13))


def test_the_states_of_a_world_of_this_process_need_no_messages():
    async def main(clock):
        goal = {i: np.array([0.02 * i, 0.0, 0.0]) for i in range(3)}
        heard = Sky(clock, n=3, goal=goal)
        room = Room(2, 0)
        seen = FlightScore(heard.bus, (0, 1, 2), goal, address=10_001, worlds=[room])
        scores = [heard.score, seen]
        running = [asyncio.create_task(score.run()) for score in scores]
        heard.tells(0, "mission", LAW_TASK)
        for step in range(20):
            k = max(0, step - 1)  # the first places are heard before the first tick
            for i in range(3):
                place = (0.03 * k + i, 0.5 * i, 0.001 * k * k)
                speed = (0.6, 0.0, 0.01 * k)
                heard.at(i, place, speed)
                if i in room.ids:
                    room.states[room.ids.index(i), :6] = [*place, *speed]
            await clock.sleep(PERIOD)
        for task in running:
            task.cancel()
        await asyncio.wait(running)
        return scores

    by_topic, by_array = run_virtual(main)
    assert by_topic.min_separation == by_array.min_separation < 2.0
    assert by_topic.errors == by_array.errors
    assert by_array.flown == pytest.approx(by_topic.flown)
    assert list(by_array.flown) == list(by_array.tracks) == [0, 1, 2]
    assert by_array.places[2].tolist() == by_topic.places[2].tolist()
