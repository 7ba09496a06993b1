"""Flights of a mission: it commands the pilot, and waits until the flight ends or fails."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import numpy as np

from crazychoir.flight.touchdown import REPLAY_TEXT
from crazychoir.guidance.member import (
    FLIGHT_LOOK_INTERVAL,
    HELD_FLIGHT_PATIENCE,
    Interrupted,
    Member,
    describe_state,
    get_state,
)
from crazychoir.guidance.turns import (
    TURN_DISTANCES,
    TURN_TIMES,
    choose_place_aside,
    find_first_at,
    is_blocked,
)
from crazychoir.planning.scaling import PICK_UP_TIME, ResumedTrajectory
from crazychoir.planning.trajectory import Trajectory
from crazychoir.safety.rules.modes import HELD_TEXT, Mode
from crazychoir.types import Vec

FLYING_MODES = (Mode.TAKEOFF, Mode.HOVER, Mode.FOLLOW)
"""Modes in which guidance flies the drone."""


@dataclass(frozen=True, slots=True)
class FlightLimits:
    """When a flight of a mission has arrived, and how long a mission tries and waits."""

    unfit_time: float = 5.0
    """s: how long a drone may take to become fit to fly, for example while a pose is missing.
    """
    arrival_distance: float = 0.2
    """m: a drone nearer to its goal has arrived."""
    most_attempts: int = 5
    """Number of attempts to reach a goal, or to fly a trajectory, before the mission gives up.
    """
    shortest_wait: float = 1e-3
    """s: shortest wait for the rest of a flight."""
    late_arrival_time: float = 2.0
    """s: how long after its planned time a flight may still arrive.

    A drone may be late in a wind that its control has yet to learn.
    """
    touchdown_time: float = 5.0
    """s: how long a mission waits for a landing beyond its planned time."""


FLIGHT_LIMITS = FlightLimits()


@dataclass(frozen=True, slots=True)
class SettlingLimits:
    """When a drone has completed its take-off and stands still, so that its control has learnt its
    trim.
    """

    risen_distance: float = 0.04
    """m: a drone farther from its take-off goal has not completed its take-off."""
    settled_distance: float = 0.003
    """m: distance from the take-off goal within which a drone counts as settled. A drone is
    settled when it stays this close, slower than `settled_speed`, for `settled_time`. Its
    thrust trim is then known to about 0.1 %.
    """
    settled_speed: float = 0.02
    """m/s: speed below which a drone counts as settled."""
    settled_time: float = 0.3
    """s: how long a drone must stay close and slow to count as settled."""
    patience: float = 5.0
    """s: how long a mission waits for a drone to settle."""


SETTLING_LIMITS = SettlingLimits()


OBEYING_GATE = "command"
"""The gate of a mission that does nothing but obey its operator until it has landed."""
GATE_STATUS_TEXTS = {
    "take-off": "waits for its operator: take-off",
    "start": "waits for its operator: start",
    OBEYING_GATE: "obeys its operator",
}
"""Text of the status while a mission waits for a command of its operator."""


def require_running(member: Member) -> None:
    """Raise Interrupted if the mission is over: it must not fly any more."""
    if member.ended:
        raise Interrupted(f"drone {member.id}: its mission has ended: {member.ended}")


async def wait_while(member: Member, seconds: float, *modes: Mode) -> None:
    """Wait for a flight, and as long as others hinder it.

    seconds: s: duration of the flight.
    modes: modes of the pilot during the flight, beside HOVER.
    Raises Interrupted in any other mode, such as landing.
    """
    pilot = member.pilot
    flying = (*modes, Mode.HOVER)
    clock = member.clock
    ends = clock.now() + seconds - pilot.flights.waited
    while (
        pilot.mode in flying
        and (left := ends + pilot.flights.waited - clock.now()) > 0.0
    ):
        pause = min(FLIGHT_LOOK_INTERVAL, max(left, FLIGHT_LIMITS.shortest_wait))
        await clock.sleep(pause, drone=member.id)
    if pilot.mode not in flying:
        raise Interrupted(f"drone {member.id}: {describe_state(pilot)}")


async def wait_for_command(
    member: Member, gate: str, seconds: float, waits: Callable[[], bool]
) -> None:
    """Wait for a command of the operator.

    gate: the command, a key of GATE_STATUS_TEXTS.
    seconds: s to wait; the time starts again while the operator flies the drone.
    waits: returns whether the command has not come yet.
    Raises Interrupted if the command does not come in time.
    """
    pilot = member.pilot
    ends = member.clock.now() + seconds
    report = member.report

    def lands() -> str:
        return (
            f", or lands in {max(0.0, ends - member.clock.now()):.0f} s"
            if pilot.airborne
            else ""
        )

    member.gate = gate
    member.report = lambda: {"task": GATE_STATUS_TEXTS[gate] + lands()}
    member.announce()
    while waits() and member.clock.now() < ends and not member.ended:
        is_flown = pilot.remaining() > 0.0 or pilot.mode is Mode.FOLLOW
        if pilot.permission.commanded and is_flown:
            ends = member.clock.now() + seconds  # its operator is at work
        await member.clock.sleep(FLIGHT_LOOK_INTERVAL, drone=member.id)
    member.gate = ""
    member.report = report
    require_running(member)
    if waits():
        raise Interrupted(
            f"drone {member.id}: no {gate} by its operator within {seconds:g} s"
        )
    if pilot.mode is Mode.CUT:
        raise Interrupted(f"drone {member.id}: {describe_state(pilot)}")


async def wait_until_ready(member: Member) -> None:
    """Wait on the ground until the drone has a pose, is not held, and is fit to fly.

    Raises Interrupted if it gets no pose in time, or if its mission is over.
    """
    pilot = member.pilot
    clock = member.clock
    ends = clock.now() + HELD_FLIGHT_PATIENCE
    while (pilot.state is None or pilot.permission.held) and clock.now() < ends:
        await clock.sleep(FLIGHT_LOOK_INTERVAL, drone=member.id)
    ends = clock.now() + FLIGHT_LIMITS.unfit_time
    while pilot.body.list_problems() and clock.now() < ends:
        await clock.sleep(FLIGHT_LOOK_INTERVAL, drone=member.id)
    require_running(member)
    if pilot.state is None:
        raise Interrupted(
            f"drone {member.id}: no pose within {HELD_FLIGHT_PATIENCE:g} s"
        )


async def wait_until_settled(member: Member, goal: Vec) -> None:
    """Wait, within SETTLING_LIMITS, until the drone has stood still at the goal for a while.

    Its control has then learnt its thrust and its trim.
    """
    clock = member.clock
    pilot = member.pilot
    stood = 0
    ends = clock.now() + SETTLING_LIMITS.patience
    while (
        pilot.mode in FLYING_MODES
        and clock.now() < ends
        and stood * FLIGHT_LOOK_INTERVAL < SETTLING_LIMITS.settled_time
    ):
        state = get_state(member)
        there = (
            np.linalg.norm(state.p - goal) < SETTLING_LIMITS.settled_distance
            and np.linalg.norm(state.v) < SETTLING_LIMITS.settled_speed
        )
        stood = stood + 1 if there else 0
        await member.clock.sleep(FLIGHT_LOOK_INTERVAL, drone=member.id)


async def reach_place(
    member: Member, p: Vec, duration: float = 0.0, yaw: float | None = None
) -> None:
    """Fly to a place that has been checked, and return when the drone is there.

    p: (3,) m, world.
    duration: s, or 0: as fast as the limits allow.
    yaw: rad, None: keep the present yaw.
    Raises Interrupted if p cannot be reached.
    """
    attempts = 0
    hindered = 0
    pilot = member.pilot
    clock = member.clock
    ends = clock.now() + HELD_FLIGHT_PATIENCE
    while attempts < FLIGHT_LIMITS.most_attempts and clock.now() < ends:
        require_running(member)
        began = clock.now()
        seconds = pilot.go_to(p, yaw, duration)
        await wait_while(
            member, seconds or FLIGHT_LOOK_INTERVAL, Mode.TAKEOFF, Mode.FOLLOW
        )
        hindered = hindered + 1 if is_blocked(pilot) else 0
        blown = (
            clock.now() + FLIGHT_LIMITS.late_arrival_time
            if seconds > 0.0 and not hindered
            else 0.0
        )
        while pilot.gap(p) >= FLIGHT_LIMITS.arrival_distance and clock.now() < blown:
            await wait_while(member, FLIGHT_LOOK_INTERVAL, Mode.TAKEOFF, Mode.FOLLOW)
        if pilot.gap(p) < (
            TURN_DISTANCES.arrived if hindered else FLIGHT_LIMITS.arrival_distance
        ):
            return
        attempts += seconds > 0.0 and pilot.follower.clearance.gave_way < began
        if hindered > 2 and find_first_at(pilot, p) < member.id:
            await wait_aside(member, p)
    place = np.round(p, 2).tolist()
    why = HELD_TEXT if pilot.permission.held else pilot.notes.text or "no reason"
    if pilot.setup.is_replayed:
        why = REPLAY_TEXT
    raise Interrupted(
        f"drone {member.id}: does not reach {place}, still {pilot.gap(p):.2f} m from it: {why}"
    )


async def wait_aside(member: Member, p: Vec) -> None:
    """Move aside, at most TURN_TIMES.turn s, while it is another drone's turn at the place p (3,) m."""
    pilot = member.pilot
    clock = member.clock
    ends = clock.now() + TURN_TIMES.turn
    aside = choose_place_aside(get_state(member).p, p, pilot.setup.fence)
    await wait_while(member, pilot.go_to(aside), Mode.FOLLOW)
    while find_first_at(pilot, p) < member.id and clock.now() < ends:
        await wait_while(member, FLIGHT_LOOK_INTERVAL, Mode.FOLLOW)


async def fly_until_stopped(member: Member, trajectory: Trajectory) -> float:
    """Fly a trajectory until it ends or is stopped, and return how many s of it were flown."""
    pilot = member.pilot
    clock = member.clock
    t = 0.0
    left = pilot.fly(trajectory)
    while pilot.flights.plan is trajectory and left > 0.0:
        t = clock.now() - pilot.flights.start
        await wait_while(
            member,
            min(FLIGHT_LOOK_INTERVAL, max(left, FLIGHT_LIMITS.shortest_wait)),
            Mode.FOLLOW,
        )
        left = pilot.remaining()
    return t


async def fly_to_the_end(
    member: Member, trajectory: Trajectory, go_to: Callable[..., Awaitable[None]]
) -> None:
    """Go to the start of a trajectory, fly it, and return when the drone is at its end.

    A flight that the safety table brakes continues from the place where it stopped.

    trajectory: a trajectory that has been checked.
    go_to: flies to a place with a yaw, as CFGuidance.go_to.
    Raises Interrupted if the flight is stopped on the way, or does not end where the trajectory
    ends.
    """
    pilot = member.pilot
    clock = member.clock
    left = trajectory
    attempts = 0
    end = trajectory.sample(trajectory.duration)
    ends = clock.now() + trajectory.duration + HELD_FLIGHT_PATIENCE
    while attempts < FLIGHT_LIMITS.most_attempts and clock.now() < ends:
        start = left.sample(0.0)
        braked = pilot.judge.braked
        await go_to(start.p, yaw=start.yaw)
        t = await fly_until_stopped(member, left)
        if (
            pilot.flights.plan is left
            and pilot.gap(end.p) <= FLIGHT_LIMITS.arrival_distance
        ):
            return
        if pilot.judge.braked == braked and not pilot.guard.acts:
            break
        if 0.0 < t < left.duration:
            flight = member.config.flight
            attempts += 1
            left = ResumedTrajectory(
                left,
                t,
                max(
                    PICK_UP_TIME,
                    4.0 * flight.speed_limit / flight.acceleration_limit,
                ),
            )
        await clock.sleep(FLIGHT_LOOK_INTERVAL, drone=member.id)
    why = HELD_TEXT if pilot.permission.held else describe_state(pilot)
    raise Interrupted(
        f"drone {member.id}: its trajectory of {trajectory.duration:.1f} s was not flown: {why}"
    )
