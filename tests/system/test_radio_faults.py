"""The safety table of drones that a radio reaches, row by row, in flight: three drones, each sent its commands another
way, have the same fault; a fourth has none."""

import asyncio
import json
import math
import os
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest
from system.agents import CRAZYCHOIR, Program
from system.hall import Hall, processes, reached

from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.radio.virtual.faults import Faults

pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.slow,
    pytest.mark.timeout(240),
    pytest.mark.usefixtures("compiled"),
]
SENDERS = ("fpqr", "frpy", "xyz")
WELL = 3
"""The drone to which nothing happens."""
HEIGHT = 0.7
HOMES = ((0.0, 0.0, 0.0), (1.2, 0.0, 0.0), (0.0, 1.2, 0.0), (1.2, 1.2, 0.0))
NORMAL = Faults().listed()


def swarm() -> SwarmConfig:
    """Drones 0 to 2 by SENDERS, drone 3 by places; a dongle, an owner and an agent for each."""
    raw = json.loads(default_swarm(4).dumps())
    for row, home, sender in zip(raw["drones"], HOMES, (*SENDERS, "xyz"), strict=True):
        row |= {"home": home, "role": sender}
    raw |= {
        "roles": [{"name": sender, "sender": sender} for sender in SENDERS],
        "mission": "figure",
        "mission_options": {"size": 0.3, "laps": 1.0, "period": 10.0},
        "flight": {"takeoff_height": HEIGHT},
        "fence": {"min": [-2.5, -2.5, 0.0], "max": [3.7, 3.7, 2.5]},
    }
    return reached(SwarmConfig.of(raw), per_dongle=1)


def choosing(watchdog: bool) -> SwarmConfig:
    """Return the swarm; watchdog: whether firmware that is sent places cuts the motors when its radio is silent."""
    return swarm().replace(radio={"watchdog": watchdog})


@dataclass
class Flight:
    """What the truth was since the fault.

    still: s after it when each drone's motors stood;  levelled: s when its firmware levelled it out;  far: m, the
    largest distance from home along an axis while they turned;  came: each half second, of each drone, s, x, y, z m,
    and the numbers of packets and poses that it has been sent: they show what went wrong.
    """

    result: dict[str, Any] = field(default_factory=dict)
    text: str = ""
    still: dict[int, float] = field(default_factory=dict)
    levelled: dict[int, float] = field(default_factory=dict)
    last: dict[int, dict[str, Any]] = field(default_factory=dict)
    far: dict[int, float] = field(default_factory=dict)
    came: dict[int, list[tuple[float, ...]]] = field(default_factory=dict)

    def look(self, t: float, state: dict[int, dict[str, Any]]) -> None:
        for i, said in state.items():
            turn = max(said["motors"]) > 0.0
            if turn:
                self.still.pop(i, None)
                self.far[i] = max(
                    self.far.get(i, 0.0),
                    *(abs(a - b) for a, b in zip(said["p"], HOMES[i], strict=True)),
                )
            else:
                self.still.setdefault(i, t)
            if said["supervisor"] == "warning: level out":
                self.levelled.setdefault(i, t)
            came = self.came.setdefault(i, [])
            if not came or t > came[-1][0] + 0.5:
                came.append(
                    (*(round(x, 2) for x in (t, *said["p"])), said["up"], said["poses"])
                )
        self.last = state

    def reason(self, i: int) -> str:
        return str(self.result["reasons"].get(str(i), ""))

    def flew_on(self, i: int) -> None:
        """Check that drone i has flown its mission and landed softly."""
        assert self.result["results"][str(i)]["success"], (i, self.reason(i), self.text)
        assert self.softly(i)

    def landed(self, i: int, reason: str, within: float) -> None:
        """Check that drone i landed softly for this reason, within so many s."""
        assert reason in self.reason(i), (i, self.reason(i), self.came[i], self.text)
        assert self.still[i] < within, (i, self.still, self.came[i], self.text)
        assert self.softly(i)

    def fell(self, i: int, reason: str, after: float, within: float) -> None:
        """Check that the motors of drone i stopped in the air for this reason, between these s."""
        assert reason in self.reason(i), (i, self.reason(i), self.came[i], self.text)
        assert after < self.still[i] < within, (i, self.still, self.text)
        assert self.last[i]["impact"] > 1.5, "it fell"

    def was_silent(self, watchdog: bool, within: float) -> None:
        """Check what drones 0 to 2 did after their radios fell silent, for good or for long."""
        for i in (0, 1):
            self.fell(i, "its radio is silent", 1.8, 2.6)
        self.planned_on(watchdog, within)

    def planned_on(self, watchdog: bool, within: float) -> None:
        """Check that drone 2 flew on by its plan on board as long as it may, and WELL to the end."""
        if watchdog:
            self.fell(2, "its radio is silent", 0.6, 1.4)
        else:
            self.landed(2, "its radio is silent for 4.", within)
        self.flew_on(WELL)

    def softly(self, i: int) -> bool:
        said = self.last[i]
        assert said["resting"]
        assert not said["crashed"], (i, said["crashed"], self.came[i], self.text)
        return bool(said["impact"] < 1.0)


Step = tuple[float, Callable[[Hall, Program], Any]]


def on(**faults: Any) -> Callable[[Hall, Program], None]:
    """Let this go wrong with the three."""

    def begin(hall: Hall, run: Program) -> None:
        for i in range(WELL):
            hall.fault(i, **faults)

    return begin


def off(*names: str) -> Callable[[Hall, Program], None]:
    """All is well again."""
    return on(**{name: NORMAL[name] for name in names})


def killed(pattern: str) -> Callable[[Hall, Program], None]:
    """kill -9 of the three's processes, by their command lines."""

    def begin(hall: Hall, run: Program) -> None:
        for i in range(WELL):
            found = processes(pattern.format(name=hall.config.name, i=i))
            assert len(found) == 1, found
            os.kill(found[0], signal.SIGKILL)

    return begin


AGENT, OWNER = (
    "[c]li.agent --swarm .*{name}.* --id {i} ",
    "[c]li.radios --swarm .*{name}.* --dongle {i} ",
)


def on_its_figure(p: Sequence[float], home: Sequence[float]) -> bool:
    return p[2] > 0.9 * HEIGHT and math.dist(p[:2], home[:2]) > 0.15


async def fly(
    folder, *steps: Step, config: SwarmConfig | None = None, seconds: float = 60.0
) -> Flight:
    """All in the air, on their figures; then the steps, at s after that; until all motors stand."""
    flight, loop = Flight(), asyncio.get_running_loop()
    async with Hall(swarm() if config is None else config, folder) as hall:
        run = await hall.fly()
        await hall.until(
            lambda state: all(
                on_its_figure(said["p"], HOMES[i]) for i, said in state.items()
            ),
            90.0,
        )
        began, todo = loop.time(), list(steps)
        while loop.time() < began + seconds:
            t = loop.time() - began
            while todo and todo[0][0] <= t:
                todo.pop(0)[1](hall, run)
            flight.look(t, hall.state())
            if len(flight.still) == len(HOMES) and not todo:
                break
            await asyncio.sleep(0.02)
        flight.result = await run.end(60.0)
        flight.last = hall.state()
        flight.text = run.text
    return flight


@pytest.mark.parametrize("watchdog", [True, False])
async def test_a_radio_silent_for_a_second(tmp_path, watchdog) -> None:
    flight = await fly(
        tmp_path, (0.0, on(silent=1)), (1.2, off("silent")), config=choosing(watchdog)
    )
    for i in (0, 1, WELL):
        flight.flew_on(i)
    for i in (0, 1):
        assert 0.4 < flight.levelled[i] < 0.8, "half a second after the last set-point"
    assert 2 not in flight.levelled, "its planner is on board"
    assert "its radio is silent" in flight.text
    if watchdog:
        flight.fell(2, "locked, as its firmware says", 0.6, 1.4)
    else:
        flight.flew_on(2)


@pytest.mark.parametrize("watchdog", [True, False])
async def test_a_radio_silent_for_five_seconds(tmp_path, watchdog) -> None:
    flight = await fly(
        tmp_path, (0.0, on(silent=1)), (5.0, off("silent")), config=choosing(watchdog)
    )
    flight.was_silent(watchdog, 13.0)


async def test_three_of_ten_packets_lost(tmp_path) -> None:
    flight = await fly(tmp_path, (0.0, on(loss=0.3)))
    for i in flight.last:
        flight.flew_on(i)


@pytest.mark.parametrize(("seconds", "lands"), [(0.2, False), (1.0, True), (5.0, True)])
async def test_cameras_that_do_not_see_it(tmp_path, seconds, lands) -> None:
    flight = await fly(tmp_path, (0.0, on(pose_lost=1)), (seconds, off("pose_lost")))
    for i in range(WELL):
        if lands:
            flight.landed(i, "limit 0.50 s: landing", 8.0)
            assert flight.far[i] < HEIGHT + 0.2
        else:
            flight.flew_on(i)
    flight.flew_on(WELL)


async def test_a_pose_that_jumps(tmp_path) -> None:
    flight = await fly(
        tmp_path, (0.0, on(offset=[0.5, 0.3, 0.0])), (5.0, off("offset"))
    )
    for i in range(WELL):
        flight.landed(i, "limit 0.50 s: landing", 8.0)
        assert flight.far[i] < HEIGHT + 0.2
    assert "the pose has jumped" in flight.text
    flight.flew_on(WELL)


@pytest.mark.parametrize("pair", [(0, 1), (1, 2)])
async def test_bodies_that_are_exchanged_in_flight(tmp_path, pair) -> None:
    flight = await fly(
        tmp_path, (0.0, lambda hall, run: hall.fault(pair[0], swap=pair[1]))
    )
    for i in flight.last:
        if i in pair:
            flight.landed(i, "limit 0.50 s: landing", 8.0)
            assert flight.far[i] < HEIGHT + 0.2
        else:
            flight.flew_on(i)


async def test_a_battery_that_is_low(tmp_path) -> None:
    flight = await fly(tmp_path, (0.0, on(voltage=3.4)))
    for i in range(WELL):
        flight.landed(i, "battery below 3.2 V for 5.", 10.0)
        assert flight.still[i] > 5.0
    flight.flew_on(WELL)


async def test_a_battery_that_is_empty(tmp_path) -> None:
    flight = await fly(tmp_path, (0.0, on(voltage=3.1)))
    for i in range(WELL):
        flight.landed(i, "below 3.0 V", 5.0)
    flight.flew_on(WELL)


async def test_drones_that_tumble(tmp_path) -> None:
    flight = await fly(tmp_path, (0.0, on(tumble=1)))
    for i in range(WELL):
        flight.fell(i, "tumbled", 0.0, 1.0)
    flight.flew_on(WELL)


async def test_agents_that_are_killed(tmp_path) -> None:
    flight = await fly(tmp_path, (0.0, killed(AGENT)))
    for i in range(WELL):
        assert flight.softly(i)
        assert flight.still[i] < 10.0
        assert "no result" in flight.text
    flight.flew_on(WELL)


@pytest.mark.parametrize("watchdog", [True, False])
async def test_owners_of_dongles_that_are_killed(tmp_path, watchdog) -> None:
    flight = await fly(tmp_path, (0.0, killed(OWNER)), config=choosing(watchdog))
    for i in (0, 1):  # an owner that starts again is there in 2 s, or it is not
        if flight.result["results"][str(i)]["success"]:
            flight.flew_on(i)
        else:
            flight.fell(
                i, " silent for ", 1.8, 2.6
            )  # seen on the floor before its owner is back, or locked after
    if not watchdog and flight.result["results"]["2"]["success"]:
        flight.flew_on(2)
        flight.flew_on(WELL)
    else:
        flight.planned_on(watchdog, 25.0)
    for i in range(WELL):
        assert (
            f"dongle {i}: its owner was ended by SIGKILL: started again" in flight.text
        )


async def test_a_host_that_is_lost_with_agents_and_owners(tmp_path) -> None:
    flight = await fly(
        tmp_path, (0.0, killed(AGENT)), (0.0, killed(OWNER)), config=choosing(False)
    )
    for i in (0, 1):
        assert 1.8 < flight.still[i] < 2.6, "as without a radio"
    assert flight.still[2] < 25.0, (
        "the restarted owner finds the drone in the air, and no agent that flies it"
    )
    assert flight.softly(2)
    assert flight.softly(WELL)


async def test_an_interrupt_by_the_operator_lands_every_drone_softly(tmp_path) -> None:
    flight = await fly(tmp_path, (0.0, lambda hall, run: hall.interrupt(run)))
    for i in flight.last:
        assert flight.softly(i)
        assert flight.still[i] < 8.0


async def test_an_emergency_stop_of_all(tmp_path) -> None:
    told: list[asyncio.Task[Program]] = []

    def stop(hall: Hall, run: Program) -> None:
        told.append(
            asyncio.ensure_future(
                Program.start(*CRAZYCHOIR, "stop", "--swarm", hall.path, "--json")
            )
        )

    flight = await fly(
        tmp_path, (0.0, stop), (8.0, lambda hall, run: hall.interrupt(run))
    )
    ended = max(flight.still.values())
    assert ended - min(flight.still.values()) < 0.5, flight.still
    for i in flight.last:
        flight.fell(i, "emergency stop", 0.0, 8.0)
    assert (await (await told[0]).end(10.0))["code"] == 0
