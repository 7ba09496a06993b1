"""What the owner of a dongle tells one drone, and when; its connection is one that keeps what it is given."""

import asyncio
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, LinkFailed, Refused
from crazychoir.platforms import Battery
from crazychoir.radio import checks
from crazychoir.radio.drone.radio_drone import (
    CAMERA_POSE_LIMITS,
    FIRMWARE_NAMES,
    PROBLEM_TEXTS,
    REPEAT_RULES,
    SILENCE_LIMITS,
    RadioDrone,
)
from crazychoir.radio.link.connection import AWAITING_LOG
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.owner import OWNER_LIMITS, RadioProcess
from crazychoir.radio.protocol.crtp import PACKET_FORMS, CrtpPort, Packet
from crazychoir.runtime.clock import run_virtual
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.identity.pose_gate import PoseGate
from crazychoir.safety.identity.takeoff_check import TiltTrack
from crazychoir.types import FPQR, FRPY, XYZ, Body, Pose, Vel

READY = checks.ReadinessBit.CAN_FLY | checks.ReadinessBit.AUTO_ARM
STOP, LINE, LAND = (
    XYZ(verb, np.array([1.0, 0.0, 1.0, 0.0, 2.0])) for verb in ("stop", "line", "land")
)


class Kept:
    """A connection that keeps the heads of what it is given, in order."""

    def __init__(self) -> None:
        self.sent: list[tuple[int, int, int]] = []
        self.silence, self.latency, self.answered, self.rssi = 0.0, 0.01, 1.0, math.nan

    def _keep(self, packet) -> None:
        self.sent.append(
            (packet.port, packet.channel, packet.data[0] if packet.data else -1)
        )

    def send(self, packet) -> None:
        self._keep(packet)

    def newest(self, kind, packet) -> None:
        self._keep(packet)

    def urgent(self, packets) -> None:
        for packet in packets:
            self._keep(packet)

    def forget(self, kind) -> None:
        """Nothing waits here."""


def head(form: str) -> tuple[int, int, int]:
    one = PACKET_FORMS[form]
    return one.port, one.channel, one.head[0]


def made(
    clock, kind: str = "xyz", rate: float = 50.0, pose: str = "mocap", **radio
) -> tuple[RadioDrone, Kept]:
    row = {"id": 0, "home": [0, 0, 0], "uri": "udp://127.0.0.1:19850", "pose": pose}
    tables = {"control": {"sender": kind}, "radio": {"log_rate": 50.0} | radio}
    config = SwarmConfig.of({"name": "a", "drones": [row]} | tables)
    bus = Bus(clock)
    bus.port(PORT_ADDRESSES.body_offset)
    drone = RadioDrone(bus, config, 0, kind, rate, TableOfContents(Path("nowhere")))
    drone.handler.thrust = 136_531.0
    drone.connection = kept = Kept()
    return drone, kept


def tell(drone: RadioDrone, supervisor: int, at: int | None = None) -> None:
    """Its log has come, of `at` ms by its own clock, None: of now."""
    at = 1000 + round(1000 * drone.clock.now()) if at is None else at
    values = dict.fromkeys(FIRMWARE_NAMES.estimate, 0.0) | {
        "pm.vbat": 4.0,
        "supervisor.info": float(supervisor),
    }
    drone._take_own(values | {FIRMWARE_NAMES.estimate[6]: 3 << 30}, at)


@virtual
async def test_set_points_leave_at_their_rate_and_the_newest_counts(clock) -> None:
    drone, kept = made(clock, "fpqr", 50.0)
    for _ in range(100):
        drone.send(FPQR(np.array([0.3, 0.0, 0.0, 0.0])))
        await clock.sleep(0.01)
    assert 49 <= len(kept.sent) <= 52


@virtual
async def test_one_that_stands_is_told_so_now_and_then(clock) -> None:
    drone, kept = made(clock)
    for _ in range(100):
        drone.send(STOP)
        await clock.sleep(0.01)
    said = [head("stop"), head("planner_stop"), head("notify_setpoint_stop")]
    assert kept.sent == said * round(1.0 / REPEAT_RULES.stop_period), (
        "who was there before us may have sent set-points"
    )


@virtual
async def test_who_has_not_flown_it_does_not_stop_its_motors(clock) -> None:
    drone, kept = made(clock)
    tell(drone, READY | checks.ReadinessBit.FLYING)
    drone.send(STOP)
    assert kept.sent == []
    drone.send(LINE)
    drone.send(STOP)
    assert kept.sent == [
        head("go_to"),
        head("notify_setpoint_stop"),
        head("planner_stop"),
    ]


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
                self.drone._heard(
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
        tell(self.drone, READY | checks.ReadinessBit.FLYING * (now - self.turned < 2.0))


@pytest.mark.parametrize("kind", ["xyz", "frpy"])
def test_one_that_lands_is_told_so_until_its_planner_does_and_never_anew(kind) -> None:
    run_virtual(lambda clock: _lands(clock, kind))


async def _lands(clock, kind) -> None:
    drone, _ = made(clock, kind)
    planner = Planner(drone)
    planner.look()
    drone.connection = None
    drone.send(LAND)
    drone.connection = planner
    for _ in range(20 * 20):
        planner.look()
        drone._go_on_landing()
        await clock.sleep(0.05)
    assert (planner.words, planner.lands, drone.flying, drone.refused_plans) == (
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
async def test_one_that_comes_down_is_not_stopped_above_the_floor_by_who_takes_it_to_have_landed(
    clock,
) -> None:
    drone, kept = made(clock, "frpy")

    async def idle(seconds: float) -> int:
        """How often its motors are stopped meanwhile."""
        kept.sent.clear()
        for _ in range(round(10 * seconds)):
            tell(drone, READY | checks.ReadinessBit.FLYING)
            drone.send(FRPY(np.zeros(4)))
            drone._go_on_landing()
            await clock.sleep(0.1)
        return kept.sent.count(head("stop")) + sum(
            port == 3 for port, _, _ in kept.sent
        )

    tell(drone, READY | checks.ReadinessBit.FLYING)
    drone.send(FRPY(np.array([0.3, 0.0, 0.0, 0.0])))
    kept.silence = 5.0
    drone.send(LAND)
    assert await idle(10.0) == 0, "it may not have heard it"
    kept.silence = 0.0
    assert await idle(2.5) == 0
    drone._heard(
        Packet(CrtpPort.HIGH_LEVEL, 0, bytes([*PACKET_FORMS["land"].head, 0, 0, 0]))
    )
    assert await idle(2.5) == 0, "it lands, for 2 s"
    assert await idle(2.0) > 0
    drone.send(LAND)
    assert await idle(REPEAT_RULES.vain_time - 0.5) == 0
    assert await idle(1.0) > 0, "it hears, and does not answer"


@virtual
async def test_a_late_answer_to_an_earlier_landing_is_none_to_this_one(clock) -> None:
    drone, kept = made(clock, "frpy")
    answer = Packet(
        CrtpPort.HIGH_LEVEL, 0, bytes([*PACKET_FORMS["land"].head, 0, 0, 0])
    )
    tell(drone, READY | checks.ReadinessBit.FLYING)
    drone.send(LAND)
    drone._go_on_landing()
    drone.send(FRPY(np.array([0.3, 0.0, 0.0, 0.0])))
    drone.send(LAND)
    kept.sent.clear()
    drone._heard(answer)
    assert kept.sent == []
    await clock.sleep(REPEAT_RULES.land_period)
    drone._go_on_landing()
    drone._heard(answer)
    assert kept.sent == [head("land"), head("notify_setpoint_stop")]


@virtual
async def test_one_that_was_cut_is_told_so_until_it_is_locked_or_switched_off_and_on(
    clock,
) -> None:
    for said, at in ((checks.SupervisorBit.LOCKED, None), (READY, 40)):
        drone, kept = made(clock)
        tell(drone, READY | checks.ReadinessBit.FLYING, 5000)
        insisting = asyncio.create_task(drone._insist(kept))
        drone.cut()
        await clock.sleep(1.0)
        assert len(kept.sent) > 10
        tell(drone, said, 6000 if at is None else at)
        kept.sent.clear()
        drone.cut()
        await clock.sleep(1.0)
        insisting.cancel()
        assert kept.sent == [], "who switches it off and on may have it again"
        drone._prepared = drone._placed = True
        assert PROBLEM_TEXTS.motors_cut in drone.problems()


@virtual
async def test_a_second_landing_does_not_change_the_first(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY | checks.ReadinessBit.FLYING)
    drone.send(LAND)
    drone.send(XYZ("land", np.array([0.0, 0.0, 0.0, 0.0, 9.0])))
    assert drone._landing is LAND
    drone.send(LINE)
    assert drone._landing is None, "somebody flies it again"


@virtual
async def test_one_that_flies_and_that_nobody_commands_is_an_orphan(clock) -> None:
    drone, _ = made(clock)
    drone._up_ns = clock.now_ns()
    tell(drone, READY | checks.ReadinessBit.FLYING)
    assert not drone.orphan
    await clock.sleep(SILENCE_LIMITS.drone_orphaned + 0.1)
    assert drone.orphan
    drone.send(LINE)
    assert not drone.orphan
    drone._flown_here = False
    assert drone.orphan
    drone.cut()
    assert not drone.orphan, "nothing is left to be done"


@virtual
async def test_a_cut_is_for_good_and_nothing_leaves_after_it(clock) -> None:
    drone, kept = made(clock)
    drone.send(LINE)
    drone.cut()
    drone.send(LINE)
    drone.send(LAND)
    drone._go_on_landing()
    assert kept.sent[-2:] == [head("emergency_stop"), head("supervisor_stop")]
    assert kept.sent.count(head("go_to")) == 1


@virtual
async def test_nothing_is_said_of_its_body_before_it_has_said_whether_it_flies(
    clock,
) -> None:
    drone, _ = made(clock)
    said = []
    reader = drone.bus.port(5).address
    drone.bus.subscribe(
        DRONE_TOPICS.body,
        PORT_ADDRESSES.body_offset,
        reader,
        Call(clock, lambda body, age: said.append(body.flying)),
    )
    drone.report()
    await clock.sleep(0.5)
    assert said == []
    tell(drone, READY | checks.ReadinessBit.FLYING)
    drone.report()
    await clock.sleep(0.5)
    assert said == [True]


@virtual
async def test_one_that_was_started_again_is_prepared_again(clock) -> None:
    drone, _ = made(clock)
    drone.release, drone._prepared = "2025.12", True
    for at in (1000, 1100):
        tell(drone, READY, at)
    assert (drone.why, drone.release, drone._prepared) == ("", "2025.12", True)
    tell(drone, READY, 40)
    assert (drone.why, drone.release, drone._prepared) == (
        "it has been started again",
        "",
        False,
    )


@virtual
async def test_its_time_may_wrap(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY, (1 << 24) - 10)
    tell(drone, READY, 90)
    assert drone.why == ""


@virtual
async def test_why_it_may_not_take_off(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY)
    assert drone.problems() == ["the cameras do not see it"]
    drone._prepared = drone._placed = True
    assert drone.problems() == ["the cameras do not see it"]
    drone.connection, drone.problem = None, "no answer within 2 s"
    assert drone.problems() == ["no answer within 2 s"]
    drone, _ = made(clock)
    tell(drone, READY | checks.ReadinessBit.FLYING)
    assert drone.problems() == []
    drone.cut()
    assert drone.problems() == [PROBLEM_TEXTS.motors_cut]


@virtual
async def test_one_that_has_spoken_is_being_prepared(clock) -> None:
    drone, _ = made(clock)
    drone.connection = None
    assert drone.problems() == ["is being connected"]
    drone._opening = SimpleNamespace(stage="no answer")
    assert drone.problems() == ["is being connected, no answer so far"]
    drone._opening, drone._logs_ns = SimpleNamespace(stage=AWAITING_LOG), clock.now_ns()
    assert drone.problems() == ["is being connected, no word of itself so far"]
    await clock.sleep(0.1)
    tell(drone, READY)
    assert drone.problems() == ["is being prepared"], (
        "its parameters take up to 2 s each"
    )


@virtual
async def test_a_virtual_one_that_is_locked_is_switched_off_and_on_by_a_command(
    clock,
) -> None:
    drone, _ = made(clock)
    await clock.sleep(0.1)
    tell(drone, READY)
    drone._prepared = drone._placed = True
    tell(drone, checks.SupervisorBit.LOCKED)
    locked = "locked by its firmware until it is switched off and on"
    assert drone.problems()[0] == f"{locked} (`crazychoir virtual fault 0 reboot=1`)"
    said: list[Body] = []
    drone.bus.port(1)
    drone.bus.subscribe(
        DRONE_TOPICS.body,
        PORT_ADDRESSES.body_offset,
        1,
        Call(clock, lambda body, age: said.append(body), "body"),
    )
    drone.report()
    await clock.sleep(0.1)
    assert said[-1].harm == drone.problems()[0]
    drone.row = msgspec.structs.replace(drone.row, uri="radio://0/80/2M/E7E7E7E701")
    assert drone.problems()[0] == locked


@virtual
async def test_the_battery_that_it_needs_to_begin_is_its_platforms(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY | checks.ReadinessBit.FLYING)
    drone._well["pm.vbat"] = 3.65
    assert drone.problems() == ["battery at 3.65 V, 3.7 V are needed to start"]
    drone._platform = replace(drone._platform, battery=Battery(begin=3.6))
    assert drone.problems() == []


@virtual
async def test_a_plan_that_is_refused_is_counted(clock) -> None:
    drone, _ = made(clock)
    for name in ("go_to", "land"):
        drone._heard(
            Packet(CrtpPort.HIGH_LEVEL, 0, bytes([*PACKET_FORMS[name].head, 0, 0, 1]))
        )
    assert drone.refused_plans == 2


@virtual
async def test_who_is_sent_places_is_given_a_watchdog_if_the_mission_wants_it(
    clock,
) -> None:
    for kind, pose, radio, fed in (
        ("xyz", "mocap", {"watchdog": True}, 6),
        ("xyz", "onboard", {}, 0),
        ("xyz", "onboard", {"watchdog": True}, 6),
        ("frpy", "mocap", {"watchdog": True}, 0),
    ):
        drone, kept = made(clock, kind, pose=pose, **radio)
        drone._feed_watchdog()
        assert not kept.sent, "on the ground nobody begins"
        drone._well["supervisor.info"] = READY | checks.ReadinessBit.FLYING
        for _ in range(30):
            drone._feed_watchdog()
            await clock.sleep(0.05)
        assert kept.sent.count(head("emergency_stop_watchdog")) == fed, (
            kind,
            pose,
            radio,
        )


@virtual
async def test_nobody_commands_it_and_it_is_beyond_the_limit(clock) -> None:
    raw = {
        "name": "a",
        "drones": [{"id": 0, "home": [0, 0, 0], "uri": "udp://127.0.0.1:19850"}],
    }
    owner = RadioProcess(clock, SwarmConfig.of(raw), 0, "radio", "here", 1)
    drone, body, kept = owner.drones[0], owner.bodies[0], Kept()
    drone.connection, drone._well["supervisor.info"] = (
        kept,
        READY | checks.ReadinessBit.FLYING,
    )
    await clock.sleep(5.0)
    for x, cut in ((1.0, False), (20.0, True)):
        drone._seen(Pose(np.array([x, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])), 0.0)
        drone._gate = PoseGate()
        owner._keep_inside(0, body)
        assert (head("emergency_stop") in kept.sent) is cut


@virtual
async def test_an_owner_that_ends_names_who_has_not_landed(clock) -> None:
    raw = {
        "name": "a",
        "drones": [{"id": 7, "home": [0, 0, 0], "uri": "udp://127.0.0.1:19850"}],
    }
    owner = RadioProcess(clock, SwarmConfig.of(raw), 0, "radio", "here", 1)
    owner.drones[7]._well["supervisor.info"] = READY | checks.ReadinessBit.FLYING
    running = asyncio.ensure_future(owner.run())
    owner.end("")
    await clock.sleep(OWNER_LIMITS.landing_time - 1.0)
    assert not owner.failure
    await clock.sleep(2.0)
    assert owner.failure.endswith("not known to have landed: 7")
    running.cancel()


def seen(drone: RadioDrone, q=(0.0, 0.0, 0.0, 1.0)) -> None:
    """The cameras have."""
    drone._seen(Pose(np.array([0.0, 0.0, 0.0, *q])), 0.0)


@virtual
async def test_in_its_ascent_it_is_told_places_until_its_body_is_known_to_move_as_it_does(
    clock,
) -> None:
    drone, kept = made(clock)

    async def said_for(seconds: float, supervisor: int) -> list[tuple[int, int, int]]:
        kept.sent.clear()
        for _ in range(round(20 * seconds)):
            tell(drone, supervisor)
            seen(drone)
            await clock.sleep(0.05)
        return [
            (port, channel, -1 if channel == 0 else first)
            for port, channel, first in kept.sent
            if port == 6
        ]

    pose, place = (
        head("external_pose"),
        (
            PACKET_FORMS["external_position"].port,
            PACKET_FORMS["external_position"].channel,
            -1,
        ),
    )
    assert set(await said_for(1.0, READY)) == {pose}
    drone.send(LINE)
    told = await said_for(4.0, READY | checks.ReadinessBit.FLYING)
    assert set(told) == {place}
    assert 38 <= len(told) <= 42, "as often as [radio] says"
    assert set((await said_for(6.0, READY | checks.ReadinessBit.FLYING))[-10:]) == {
        pose
    }, "it has been watched for long enough"
    await said_for(0.5, READY)
    drone.send(LINE)
    assert set(await said_for(1.0, READY | checks.ReadinessBit.FLYING)) == {place}, (
        "so is its next ascent"
    )


@virtual
async def test_whose_body_moves_otherwise_is_told_nothing_more_and_may_not_take_off(
    clock,
) -> None:
    drone, kept = made(clock)
    drone._prepared = drone._placed = True
    for k in range(60):
        tell(drone, READY | checks.ReadinessBit.FLYING * (k > 20))
        swing = 0.05 * max(k - 22, 0) / 2.0
        drone._take_off.sights.tracks[0].add(
            clock.now(), complex(0.0, swing), 0.0
        )  # its own tilt stays
        if k == 20:
            drone.send(LINE)
        await clock.sleep(0.05)
    assert drone.status().astray == "it does not tilt as its body does"
    assert any(text.startswith(drone.status().astray) for text in drone.problems())
    kept.sent.clear()
    seen(drone)
    assert kept.sent == []
    drone._forgive()
    assert drone.status().astray, "it may fly"
    tell(drone, READY)
    drone._pose.put(Pose(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])), 0.0)
    drone._forgive()
    assert drone.status().astray, "nobody has touched it"
    await clock.sleep(CAMERA_POSE_LIMITS.longest_gap + 0.1)
    drone._forgive()
    assert drone.status().astray == ""


@virtual
async def test_what_was_overtaken_changes_nothing(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY, 5000)
    await clock.sleep(0.9)
    tell(drone, READY | checks.ReadinessBit.FLYING, 5900)
    tell(drone, READY, 5020)
    assert (drone.flying, drone.why) == (True, "")


@pytest.mark.parametrize("exchanged", [False, True])
def test_what_it_says_late_is_compared_with_what_the_cameras_saw_then(
    exchanged,
) -> None:
    @virtual
    async def check(clock) -> None:
        drone, _ = made(clock)
        tracks, held = drone._take_off.sights.tracks, []
        tracks[1] = TiltTrack()

        def tilted(j: int, t: float) -> float:
            return 0.3 * max(t - 1.0, 0.0) * math.sin((7.0 + 4.0 * j) * t)

        for k in range(110):
            t = clock.now()
            for j, track in tracks.items():
                track.add(t, complex(0.0, tilted(1 - j if exchanged else j, t)))
            roll = 0.5 * tilted(0, t)
            if k == 50:
                drone.send(LINE)
            held.append(
                (
                    np.array([math.sin(roll), 0.0, 0.0, math.cos(roll)]),
                    k > 55,
                    round(1000 * t) + 3000,
                )
            )
            if not 60 <= k < 105:
                for q, flies, at in held:
                    drone._take_off.note(drone._uptime.taken(t, at), q, flies, 0.01)
                held.clear()
            await clock.sleep(0.02)
        assert bool(drone._take_off.found) is exchanged

    check()


class Slow(Kept):
    """A connection that asks in vain, until it is told to go on."""

    def __init__(self, uri: str = "") -> None:
        super().__init__()
        self.uri, self.dongle_failure, self.failure = uri, "", ""
        self.goes_on, self.begun, self.version = asyncio.Event(), 0, 12

    async def open(self, seconds: float, tables: float) -> None:
        """At once."""

    async def close(self) -> None:
        """At once."""

    async def reset_logs(self, seconds: float) -> None:
        await self.goes_on.wait()

    async def log(self, name, variables, period, data, seconds) -> None:
        self.begun += 1
        await self.goes_on.wait()


@virtual
async def test_a_cut_leaves_at_once_while_its_link_is_being_asked(clock) -> None:
    drone, _ = made(clock)
    drone.connection, slow = None, Slow()
    connecting = asyncio.ensure_future(drone._connect(slow, clock.now()))
    await clock.sleep(0.1)
    assert (slow.begun, drone.connection, slow.sent) == (1, None, [])
    drone.cut()
    assert slow.sent[0] == head("emergency_stop")
    connecting.cancel()


class Asked(Slow):
    """A connection to a drone, on the ground unless it says otherwise, which says its release."""

    def __init__(
        self,
        drone: RadioDrone,
        release: str = "2025.12",
        version: int = 12,
        supervisor: int = READY,
    ) -> None:
        super().__init__()
        self.drone, self.release, self.version, self.supervisor = (
            drone,
            release,
            version,
            supervisor,
        )

    async def log(self, name, variables, period, data, seconds) -> None:
        self.begun += 1
        await self.drone.clock.sleep(0.1)
        tell(self.drone, self.supervisor)

    async def ask(self, packet, answers, seconds, again) -> Packet:
        answer = Packet(CrtpPort.PLATFORM, 1, b"\x01" + self.release.encode())
        assert answers(answer)
        return answer


@virtual
async def test_one_whose_thrust_is_not_known_is_refused_each_time(clock) -> None:
    drone, _ = made(clock, "fpqr")
    drone.connection = None
    for _ in range(3):
        with pytest.raises(ConfigError, match=r"found 2025\.09; .* set thrust_map"):
            await drone._connect(Asked(drone, "2025.09"), clock.now())
        assert drone.connection is None


@virtual
async def test_one_whose_protocol_is_too_old_is_refused(clock) -> None:
    drone, _ = made(clock, "vel")
    drone.connection, old = None, Asked(drone, version=8)
    with pytest.raises(
        ConfigError, match=r"drone 0: protocol .* found version 8; allowed: 9 or newer"
    ) as e:
        await drone._connect(old, clock.now())
    assert drone.connection is None
    drone._failed(e.value, clock.now())
    assert drone.state_of_link == "refused"


@virtual
async def test_one_that_is_refused_while_it_flies_is_landed_first(clock) -> None:
    for kind, link in (("vel", {"version": 8}), ("fpqr", {"release": "2025.09"})):
        drone, _ = made(clock, kind)
        drone.connection, old = (
            None,
            Asked(drone, supervisor=READY | checks.ReadinessBit.FLYING, **link),
        )
        await drone._connect(old, clock.now())
        assert drone.connection is old
        assert "2025.09" in drone.problem or "version 8" in drone.problem
        await clock.sleep(SILENCE_LIMITS.drone_orphaned + 0.1)
        tell(drone, READY | checks.ReadinessBit.FLYING)
        drone.send(
            Vel(np.array([0.1, 0.0, 0.0, 0.0]))
            if kind == "vel"
            else FPQR(np.array([0.3, 0.0, 0.0, 0.0]))
        )
        assert old.sent == []
        assert drone.orphan
        drone.send(LAND)
        drone._go_on_landing()
        assert old.sent[0] == head("land")
        drone.cut()
        assert head("emergency_stop") in old.sent
        tell(drone, READY)
        with pytest.raises(LinkFailed, match=r"2025\.09|version 8"):
            await drone._look_after(old)


@virtual
async def test_a_cut_is_said_again_until_it_was_heard_also_while_its_link_is_being_opened(
    clock,
) -> None:
    drone, _ = made(clock)
    drone.connection, opening = None, Slow()
    drone._opening = opening
    insisting = asyncio.ensure_future(drone._insist(opening))
    await clock.sleep(0.5)
    assert opening.sent == []
    drone.cut()
    opening.sent.clear()
    await clock.sleep(0.5)
    assert opening.sent.count(head("emergency_stop")) == 10
    tell(drone, checks.SupervisorBit.LOCKED)
    opening.sent.clear()
    await clock.sleep(0.5)
    assert opening.sent == []
    insisting.cancel()


@virtual
async def test_who_looks_after_a_drone_that_says_nothing_of_itself_goes_on_with_all_else(
    clock,
) -> None:
    drone, _ = made(clock, watchdog=True)
    drone._prepared = drone._placed = True
    tell(drone, READY | checks.ReadinessBit.FLYING)
    drone.connection = slow = Slow()
    drone.send(LAND)
    looking = asyncio.ensure_future(drone._look_after(slow))
    await clock.sleep(2.5)
    assert slow.begun == 0, "its logs are being reset"
    slow.sent.clear()
    await clock.sleep(2.0)
    assert slow.sent.count(head("land")) == 8
    assert slow.sent.count(head("emergency_stop_watchdog")) == 8
    slow.goes_on.set()
    await clock.sleep(0.1)
    assert slow.begun == 1, "one at a time"
    looking.cancel()
    await asyncio.wait([looking])
    await drone._end_work()


@virtual
async def test_a_link_that_is_late_in_flight_is_said_now_and_then(clock) -> None:
    drone, kept = made(clock)
    drone._prepared = drone._placed = True
    kept.failure = kept.dongle_failure = ""
    kept.latency, said = 0.4, []
    drone._say = lambda topic, text: said.append(text)
    looking = asyncio.ensure_future(drone._look_after(kept))
    for supervisor, texts in (
        (READY, set()),
        (READY | checks.ReadinessBit.FLYING, {"its link takes 0.40 s there and back"}),
    ):
        tell(drone, supervisor)
        await clock.sleep(0.5)
        assert {text.split(",")[0] for text in said} == texts
    looking.cancel()


@virtual
async def test_what_fails_beside_ends_the_link(clock) -> None:
    drone, _ = made(clock)
    slow = Slow()

    async def fails(connection) -> None:
        raise LinkFailed("udp", "no answer")

    drone._begin_logs_again = fails
    await clock.sleep(2.0)
    with pytest.raises(LinkFailed, match="no answer"):
        await drone._look_after(slow)


@virtual
async def test_what_an_attempt_to_connect_failed_by_is_said_and_does_not_fail_the_next(
    clock,
) -> None:
    drone, _ = made(clock)
    drone.connection, before = None, []

    async def fails(connection, began) -> None:
        before.append(drone.why)
        drone._lost("the driver has given up")
        raise LinkFailed("udp://127.0.0.1:19850", "no answer within 1.5 s")

    drone._connect = fails
    running = asyncio.ensure_future(drone.run())
    await clock.sleep(1.0)
    running.cancel()
    assert len(before) > 2
    assert set(before) == {""}
    (problem,) = drone.problems()
    assert "no answer within 1.5 s" in problem


@virtual
async def test_a_line_that_begins_far_away_gets_the_time_for_it(clock) -> None:
    drone, _ = made(clock, "xyz")
    tell(drone, READY)
    durations, planned = [], drone.handler.planned
    drone.handler.planned = lambda command: (
        durations.append(float(command.flat[4])) or planned(command)
    )
    for x in (0.3, 3.0):
        drone.send(XYZ("line", np.array([x, 0.0, 0.0, 0.0, 0.2])))
    assert durations[0] == 0.2, "it follows late"
    assert durations[1] == pytest.approx(3.0 / (1.8 * drone.config.flight.speed_limit))


@virtual
async def test_only_the_newest_line_waits(clock) -> None:
    drone, kept = made(clock, "xyz")
    tell(drone, READY)
    waits = []
    kept.newest = lambda kind, packet: waits.append(kind)
    drone.send(LINE)
    assert waits == [], "that set-points have ended goes with it"
    drone.send(LINE)
    drone.send(LAND)
    drone.send(STOP)
    assert waits == ["command"]


def up(z: float) -> Pose:
    return Pose(np.array([0.0, 0.0, z, 0.0, 0.0, 0.0, 1.0]))


@virtual
async def test_one_that_was_not_reached_and_flies_is_not_stopped_by_who_takes_it_to_be_down(
    clock,
) -> None:
    drone, kept = made(clock)
    drone._prepared = drone._placed = True
    kept.failure = kept.dongle_failure = ""
    tell(drone, READY | checks.ReadinessBit.FLYING)
    drone.send(LINE)
    drone.send(STOP)
    assert kept.sent[-1] == head("planner_stop"), "who has flown it may stop it"
    await clock.sleep(REPEAT_RULES.stop_period)
    drone.send(LINE)
    looking = asyncio.ensure_future(drone._look_after(kept))
    kept.silence = SILENCE_LIMITS.drone_unreached + 0.1
    await clock.sleep(0.1)
    drone.send(LINE)
    kept.silence = 0.0
    tell(drone, READY | checks.ReadinessBit.FLYING)
    drone._seen(up(1.0), 0.0)
    kept.sent.clear()
    drone.send(STOP)
    assert kept.sent == []
    assert not drone.orphan, "its pilot may fly it on"
    await clock.sleep(SILENCE_LIMITS.drone_orphaned + 0.1)
    assert drone.orphan
    drone._gate = PoseGate()
    drone._seen(up(0.05), 0.0)
    drone.send(STOP)
    assert head("planner_stop") in kept.sent, "it stands"
    looking.cancel()
    await asyncio.wait([looking])
    await drone._end_work()


@virtual
async def test_one_wrong_pose_does_not_end_the_watch_of_a_take_off(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY)
    drone.send(LINE)
    tell(drone, READY | checks.ReadinessBit.FLYING)
    for k in range(60):
        drone._seen(up(5.0 if k == 10 or k >= 40 else 0.0), 0.0)
        assert drone._take_off.watched is (
            k <= 40 + round(CAMERA_POSE_LIMITS.longest_jump / 0.01)
        ), k
        await clock.sleep(0.01)


@virtual
async def test_homes_count_again_once_it_was_switched_off(clock) -> None:
    drone, _ = made(clock)
    for at, flying, flown in (
        (1000, checks.ReadinessBit.FLYING, True),
        (1100, 0, True),
        (40, 0, False),
    ):
        tell(drone, READY | flying, at)
        drone.report()
        assert drone._has_flown is flown


@virtual
async def test_one_that_is_silent_may_be_carried_about(clock) -> None:
    raw = {
        "name": "a",
        "drones": [{"id": 0, "home": [0, 0, 0], "uri": "udp://127.0.0.1:19850"}],
    }
    owner = RadioProcess(clock, SwarmConfig.of(raw), 0, "radio", "here", 1)
    drone, body, kept = owner.drones[0], owner.bodies[0], Kept()
    drone.connection, drone._well["supervisor.info"] = (
        kept,
        READY | checks.ReadinessBit.FLYING,
    )
    kept.silence = SILENCE_LIMITS.link_lost + 0.1
    await clock.sleep(5.0)
    drone._seen(Pose(np.array([20.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])), 0.0)
    owner._keep_inside(0, body)
    assert head("emergency_stop") not in kept.sent


class Arms(Kept):
    """A connection to a drone that arms, or refuses to."""

    uri = "udp://127.0.0.1:19850"

    def __init__(self, lets: bool) -> None:
        super().__init__()
        self.lets = lets

    async def ask(self, packet, answers, seconds, again) -> Packet:
        self._keep(packet)
        answer = Packet(
            packet.port,
            packet.channel,
            bytes([0x80 | packet.data[0], self.lets, packet.data[1]]),
        )
        assert answers(answer)
        return answer


@virtual
async def test_motors_that_wait_for_it_are_armed_or_it_is_said_why_not(clock) -> None:
    drone, _ = made(clock)
    assert await drone.arm() == "ready: its firmware needs no arming"
    drone._platform = replace(
        drone._platform, firmware=replace(drone._platform.firmware, needs_arming=True)
    )
    drone.connection = arms = Arms(True)
    assert await drone.arm() == "armed"
    assert arms.sent == [head("arm")]
    drone.connection = Arms(False)
    with pytest.raises(Refused, match=r"drone 0: .*refuses to arm"):
        await drone.arm()
    drone.connection, drone.why = None, "no answer within 3 s"
    with pytest.raises(Refused, match=r"drone 0: .*no answer within 3 s"):
        await drone.arm()
