"""A drone's sensors as inputs to guidance: log variables of both worlds, near and far, asked for by name."""

import asyncio
import math
from types import SimpleNamespace

import pytest
from virtual_time import virtual

from crazychoir.agent.agent import Agent
from crazychoir.agent.worlds import WorldProcess
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.sensors import Sensors
from crazychoir.runtime.clock import run_virtual
from crazychoir.runtime.mailbox import DropOldest
from crazychoir.simulation.remote import RemoteLink
from crazychoir.simulation.telemetry import list_log_names

BRISK = {
    "takeoff_height": 0.3,
    "speed_limit": 2.0,
    "acceleration_limit": 4.0,
    "landing_speed": 0.6,
}
EMPTY = 3.9
"""V, below which the drone of these tests lands: its battery is at 90 % at the start."""


def config_of(uri, **tables):
    drones = [{"id": 0, "home": [0.0, 0.0, 0.0], "uri": uri, "platform": "cf21"}]
    return SwarmConfig.of({"name": "a", "drones": drones, "flight": BRISK, **tables})


def flown(guidance, config):
    """The result of drone 0, and what an observer has heard of its telemetry."""

    async def main(clock):
        agent = Agent(
            clock, config, SimpleNamespace(guidance=lambda i, config: guidance), (0,)
        )
        agent.bus.port(PORT_ADDRESSES.first_observer)
        heard = DropOldest(clock, "telemetry", 10_000)
        agent.bus.subscribe(
            DRONE_TOPICS.telemetry, 0, PORT_ADDRESSES.first_observer, heard
        )
        results = await agent.run()
        return results[0], heard.received

    return run_virtual(main)


class UntilEmpty(CFGuidance):
    """Hovers until its battery is below a threshold."""

    async def mission(self):
        battery = self.log("pm.vbat", "stabilizer.thrust", period=0.1)
        none = battery["pm.vbat"]
        await self.take_off()
        began = self.member.clock.now()
        while (volts := battery["pm.vbat"]) is None or volts > EMPTY:
            assert self.member.clock.now() < began + 60.0
            await self.sleep(0.05)
        age, seconds = battery.age("pm.vbat"), self.member.clock.now() - began
        await self.land()
        return {
            "none": none,
            "volts": volts,
            "age": age,
            "seconds": seconds,
            "thrust": battery["stabilizer.thrust"],
        }


@pytest.mark.parametrize("charge", [0.95, 0.5])
def test_a_mission_lands_when_its_battery_is_below_a_threshold(charge):
    result, messages = flown(
        UntilEmpty(), config_of("sim://motors", motors={"battery": charge})
    )
    assert result["success"], result
    assert result["none"] is None
    assert 3.5 < result["volts"] <= EMPTY
    assert 0.0 <= result["age"] <= 0.11
    assert messages > 10
    if charge == 0.5:
        assert result["seconds"] < 0.1, "it is empty as soon as it is in the air"
    else:
        assert result["seconds"] > 3.0


class Level(CFDistributedFeedback):
    """A law that hovers, and reads its attitude in each step."""

    duration = 1.0

    def __init__(self):
        self.seen = []

    def step(self, me, heard):
        said = self.log(
            "stabilizer.roll", "stabilizer.pitch", "stateEstimate.z", period=0.01
        )
        self.seen.append(
            (
                me.p[2],
                said["stateEstimate.z"],
                said.age("stateEstimate.z"),
                said["stabilizer.roll"],
            )
        )


@pytest.mark.parametrize("uri", ["sim://", "sim://motors"])
def test_a_law_reads_its_sensors_in_each_step(uri):
    law = Level()
    result, messages = flown(law, config_of(uri))
    assert result["success"]
    later = law.seen[10:]
    assert len(later) > 80
    assert all(
        abs(z - seen) < 0.02 and age < 0.021 and abs(roll) < 5.0
        for z, seen, age, roll in later
    ), later
    assert 90 < messages < 400, "one each 10 ms from the first step on"


def test_nothing_is_published_without_a_request():
    class Rises(CFGuidance):
        async def mission(self):
            await self.take_off()
            await self.land()

    assert flown(Rises(), config_of("sim://"))[1] == 0


@pytest.mark.parametrize(
    ("uri", "name", "near"),
    [
        ("sim://motors", "pm.vbatt", "pm.vbat"),
        ("sim://", "pm.vbat", 'With uri = "sim://motors" it has'),
        ("sim://", "gyro.w", "gyro.x"),
    ],
)
def test_names_that_a_platform_does_not_have_are_refused_with_the_nearest(
    uri, name, near
):
    class Asks(CFGuidance):
        async def mission(self):
            self.log(name)

    result, _ = flown(Asks(), config_of(uri))
    assert f"drone 0: log: found {name}; allowed: " in result["reason"]
    assert near in result["reason"]


@pytest.mark.parametrize("period", [0.0, 0.015, 3.0, math.nan])
def test_periods_are_those_of_the_firmwares_log_blocks(period):
    sensors = Sensors(
        SimpleNamespace(address=3, bus=SimpleNamespace(clock=None)),
        3,
        ("a.b",),
        lambda *asked: None,
    )
    with pytest.raises(
        ConfigError, match=r"drone 3: log.*multiples of 0.01 s up to 2.55 s"
    ):
        sensors.log(("a.b",), period)


@virtual
async def test_a_body_in_the_process_of_its_owner_says_what_it_is_asked_and_refuses_the_rest(
    clock,
):
    config = config_of("sim://", world={"owned": True})
    world = WorldProcess(clock, config, "world", "here", 1)
    port = world.bus.port(0)  # the drone's, without a network between
    serving = asyncio.create_task(world.serve())
    try:
        link = RemoteLink(port)
        sensors = Sensors(
            port, PORT_ADDRESSES.body_offset, list_log_names("sim://"), link.ask
        )
        seen = sensors.log(("stateEstimate.x", "gyro.z"), 0.05)
        assert seen.fresh() == {}
        await clock.sleep(0.2)
        assert seen.fresh() == {"stateEstimate.x": 0.0, "gyro.z": 0.0}
        assert 0.0 <= seen.age("gyro.z") <= 0.05
        with pytest.raises(KeyError, match="was not asked for"):
            seen["gyro.x"]
        foreign = Sensors(port, PORT_ADDRESSES.body_offset, None, link.ask)
        nothing = foreign.log(("no.such",), 0.1)
        await clock.sleep(0.5)
        assert nothing["no.such"] is None
    finally:
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)


@virtual
async def test_values_grow_stale(clock):
    bus = Bus(clock)
    sensors = Sensors(bus.port(0), 0, ("a.b", "a.c"), lambda *asked: None)
    seen = sensors.log(("a.b",), 0.1)
    assert sensors.log(("a.b",), 0.1) is seen
    bus.ports[0].publish(
        DRONE_TOPICS.telemetry, {"a.b": [1.0, 0.05], "a.c": [7.0, 0.0]}
    )
    assert (seen["a.b"], seen.age("a.b")) == (1.0, pytest.approx(0.05))
    bus.ports[0].publish(DRONE_TOPICS.telemetry, {"a.b": [0.5, 0.2]})
    assert seen["a.b"] == 1.0, "an older one does not count"
    await clock.sleep(1.0)
    assert seen["a.b"] is None
