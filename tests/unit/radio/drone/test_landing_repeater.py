"""A landing that is repeated until the planner on board confirms it."""

import math

import numpy as np
import pytest
from radio_drones import LAND, LINE, READY, Kept, head, made, tell
from virtual_time import virtual

from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.drone.radio_drone import RadioDrone
from crazychoir.radio.drone.timing import REPEAT_RULES
from crazychoir.radio.protocol.crtp import PACKET_FORMS, CrtpPort, Packet
from crazychoir.runtime.clock import run_virtual
from crazychoir.types import FRPY, XYZ


class Planner(Kept):
    """A planner on board: it lands from idle, too, 2 s long, and refuses what it is told while it lands.

    It hears a word to land after two are lost, and all that it is told beside them: a planner in control that does not
    land has no plan, and switches the motors off.
    """

    def __init__(self, drone: RadioDrone) -> None:
        super().__init__()
        self.drone, self.lands, self.words, self.ends, self.turned = (
            drone,
            0,
            0,
            -math.inf,
            0.0,
        )
        self.fell = False

    def send(self, packet) -> None:
        super().send(packet)
        now = self.drone.clock.now()
        if self.sent[-1] == head("land"):
            self.words += 1
            if self.words > 2:
                landing = now < self.ends
                self.lands, self.ends = (
                    self.lands + (not landing),
                    self.ends if landing else now + LAND.flat[4],
                )
                self.drone.landing.hear(
                    Packet(
                        CrtpPort.HIGH_LEVEL,
                        0,
                        bytes([*PACKET_FORMS["land"].head, 0, 0, landing]),
                    )
                )
        self.fell = self.fell or (
            self.sent[-1] == head("notify_setpoint_stop") and not self.lands
        )

    def look(self) -> None:
        """Its motors turn until it has landed, and count as turning for 2 s more."""
        now = self.drone.clock.now()
        self.turned = now if now < self.ends or not self.lands else self.turned
        tell(self.drone, READY | SUPERVISOR_BITS.flying * (now - self.turned < 2.0))


@pytest.mark.parametrize("kind", ["xyz", "frpy"])
def test_a_landing_command_is_repeated_until_the_planner_lands_and_not_after(
    kind,
) -> None:
    run_virtual(lambda clock: _lands(clock, kind))


async def _lands(clock, kind) -> None:
    drone, _ = made(clock, kind)
    planner = Planner(drone)
    planner.look()
    drone.link.connection = None
    drone.commands.send(LAND)
    drone.link.connection = planner
    for _ in range(20 * 20):
        planner.look()
        drone.landing.go_on()
        await clock.sleep(0.05)
    assert (
        planner.words,
        planner.lands,
        drone.estimate.is_flying,
        drone.landing.refused_plans,
    ) == (
        3,
        1,
        False,
        0,
    )
    assert not planner.fell, "its planner was given control before it landed"
    assert (
        planner.sent.index(head("notify_setpoint_stop"))
        == planner.sent.index(head("land")) + 3
    ), "at the answer"
    assert planner.sent.count(head("notify_setpoint_stop")) > 10, "one word may be lost"
    assert head("planner_stop") in planner.sent[-2:]


@virtual
async def test_a_landing_drone_is_not_stopped_above_the_floor_by_zero_thrust(
    clock,
) -> None:
    drone, kept = made(clock, "frpy")

    async def idle(seconds: float) -> int:
        """How often its motors are stopped meanwhile."""
        kept.sent.clear()
        for _ in range(round(10 * seconds)):
            tell(drone, READY | SUPERVISOR_BITS.flying)
            drone.commands.send(FRPY(np.zeros(4)))
            drone.landing.go_on()
            await clock.sleep(0.1)
        return kept.sent.count(head("stop")) + sum(
            port == 3 for port, _, _ in kept.sent
        )

    tell(drone, READY | SUPERVISOR_BITS.flying)
    drone.commands.send(FRPY(np.array([0.3, 0.0, 0.0, 0.0])))
    kept.silence = 5.0
    drone.commands.send(LAND)
    assert await idle(10.0) == 0, "it may not have heard it"
    kept.silence = 0.0
    assert await idle(2.5) == 0
    drone.landing.hear(
        Packet(CrtpPort.HIGH_LEVEL, 0, bytes([*PACKET_FORMS["land"].head, 0, 0, 0]))
    )
    assert await idle(2.5) == 0, "it lands, for 2 s"
    assert await idle(2.0) > 0
    drone.commands.send(LAND)
    assert await idle(REPEAT_RULES.vain_time - 0.5) == 0
    assert await idle(1.0) > 0, "it hears, and does not answer"


@virtual
async def test_a_late_answer_to_an_earlier_landing_is_none_to_this_one(clock) -> None:
    drone, kept = made(clock, "frpy")
    answer = Packet(
        CrtpPort.HIGH_LEVEL, 0, bytes([*PACKET_FORMS["land"].head, 0, 0, 0])
    )
    tell(drone, READY | SUPERVISOR_BITS.flying)
    drone.commands.send(LAND)
    drone.landing.go_on()
    drone.commands.send(FRPY(np.array([0.3, 0.0, 0.0, 0.0])))
    drone.commands.send(LAND)
    kept.sent.clear()
    drone.landing.hear(answer)
    assert kept.sent == []
    await clock.sleep(REPEAT_RULES.land_period)
    drone.landing.go_on()
    drone.landing.hear(answer)
    assert kept.sent == [head("land"), head("notify_setpoint_stop")]


@virtual
async def test_a_second_landing_does_not_change_the_first(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY | SUPERVISOR_BITS.flying)
    drone.commands.send(LAND)
    drone.commands.send(XYZ("land", np.array([0.0, 0.0, 0.0, 0.0, 9.0])))
    assert drone.landing.command is LAND
    drone.commands.send(LINE)
    assert drone.landing.command is None, "a program flies it again"


@virtual
async def test_a_plan_that_is_refused_is_counted(clock) -> None:
    drone, _ = made(clock)
    for name in ("go_to", "land"):
        drone.landing.hear(
            Packet(CrtpPort.HIGH_LEVEL, 0, bytes([*PACKET_FORMS[name].head, 0, 0, 1]))
        )
    assert drone.landing.refused_plans == 2


@virtual
async def test_a_planner_that_never_ends_its_landing_is_believed_for_a_while_if_heard(
    clock,
) -> None:
    for silence, waits in [(0.0, REPEAT_RULES.longest_overrun), (5.0, 0.0)]:
        drone, kept = made(clock)
        tell(drone, READY | SUPERVISOR_BITS.flying | SUPERVISOR_BITS.planned)
        drone.commands.send(LAND)
        drone.landing.go_on()
        drone.landing.hear(
            Packet(CrtpPort.HIGH_LEVEL, 0, bytes([*PACKET_FORMS["land"].head, 0, 0, 0]))
        )
        kept.silence = silence
        kept.sent.clear()
        over = clock.now() + LAND.flat[4] + REPEAT_RULES.stop_delay + waits
        while head("planner_stop") not in kept.sent:
            assert clock.now() < over + 1.0
            assert drone.landing.is_under_way() == (clock.now() < over)
            await clock.sleep(0.01)
            drone.landing.go_on()
        assert clock.now() >= over
