"""The stages of a tick that run in Python for one drone."""

from typing import Protocol

import numpy as np

from crazychoir.bus.port import Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.control.rows import INPUT_SIZE
from crazychoir.control.senders import FPQRSender
from crazychoir.errors import error_text
from crazychoir.filters.state_filter import StateFilter
from crazychoir.flight.batch import Course, DroneRow, FlightControllerKind
from crazychoir.flight.body import DroneBody
from crazychoir.flight.follower import FlightFollower
from crazychoir.flight.judge import Judge
from crazychoir.flight.notes import FlightNotes
from crazychoir.flight.permission import Permission
from crazychoir.flight.setup import THRUST_SENDERS, FlightSetup
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.hearing import LARGEST_ACCELERATION_NORM
from crazychoir.safety.airspace.states_by_hand import STATE_BYTES
from crazychoir.safety.rules.guard import Action
from crazychoir.types import (
    Acceleration,
    Command,
    FullState,
    Pose,
    Reference,
)


class Flier(Protocol):
    """The parts of a drone that its stages work with."""

    port: Port
    """Port of the drone."""
    body: DroneBody
    """Body of the drone."""
    setup: FlightSetup
    """What is known of the drone."""
    row: DroneRow
    """Its record in the batch."""
    notes: FlightNotes
    """Its notes."""
    follower: FlightFollower
    """What it flies."""
    judge: Judge
    """What it does when something happens."""
    permission: Permission
    """What it may do."""

    def fail(self, error: BaseException) -> None:
        """React to an error in a stage."""
        ...


class DroneStages:
    """Believes poses, judges, publishes, notes evasions and commands for one drone.

    flier: the parts of the drone
    state_filter: of the drone
    """

    def __init__(self, flier: Flier, state_filter: StateFilter) -> None:
        self._flier = flier
        self._setup = flier.setup
        self._row = flier.row
        self._notes = flier.notes
        self._follower = flier.follower
        self._clearance = flier.follower.clearance
        self.filter = state_filter
        flier.port.latched.offer(
            DRONE_TOPICS.state, lambda: self._row.state, self._compute_state_age
        )
        controls = flier.setup.controls
        self._knows_commands = isinstance(controls.sender, FPQRSender)
        row = flier.row.drone
        row["knows_commands"] = self._knows_commands
        row["sends_rows"] = controls.sender.kind in THRUST_SENDERS and np.shares_memory(
            controls.rows, flier.row.controls
        )

    def fail(self, error: BaseException) -> None:
        """React to an error in a stage."""
        self._flier.fail(error)

    def receive_pose(self, pose: Pose | None, age: float) -> Pose | None:
        """Return the pose with its age on arrival, if it is believed; else None.

        age: s that the pose was on its way
        """
        # The pose was on its way for a while, or its own age is not a number.
        if pose is not None and not pose.age >= age:
            pose = Pose(pose.flat, age)
        if pose is None:
            return None
        now = self._flier.port.bus.clock.now()
        is_flying = self._flier.permission.airborne
        return self._flier.judge.ground_watch.believe(pose, now, is_flying)

    def judge(self, now: float) -> None:
        """Decide what the drone does in this tick, at `now` in s."""
        state = self._row.state
        if state is not None:
            self._flier.judge.decide(state, now)

    def _compute_state_age(self) -> float:
        """Return the present age of the newest state, s."""
        row = self._row.drone
        since_ns = self._flier.port.bus.clock.now_ns() - row["ticked_ns"]
        return float(row["age"]) + float(since_ns) / NS_PER_SECOND

    def publish_state(self) -> None:
        """Publish the state of this tick."""
        state = self._row.state
        if state is not None:
            self._flier.port.publish(DRONE_TOPICS.state, state, state.age)

    def count_messages(self, sent: int, lost: int) -> None:
        """Count states that were sent to other drones, and those of them that were lost."""
        counters = self._flier.port.counters
        counters.sent += sent
        counters.lost += lost
        counters.bytes += STATE_BYTES * sent

    def seek(self) -> None:
        """Ask others for the states of drones that are not heard."""
        collision = self._clearance.filter
        if collision is not None:
            collision.hearsay.seek()

    def note_evasion(self) -> None:
        """Note which drone this one evades, or that it evades no more."""
        row = self._row.drone
        if not row["evades"]:
            self._notes.end_evasion()
        # If the safety table acts, it has already given the reason.
        elif self._row.obeyed is Action.NOMINAL:
            other = int(row["evades_drone"])
            is_first = row["evasion_ticks"] == 1
            self._notes.say_evades(None if other < 0 else other, is_first)

    def command_by_hand(self, now: float) -> None:
        """Compute the command of this tick in Python, at `now` in s, and send it."""
        if self._row.drone["course"] == Course.IDLE:
            self.send(self._setup.controls.sender.idle)
        else:
            self.send(self._compute_command(now))

    def send_input(self) -> None:
        """Send the input that compiled code has written into the record."""
        u = self._row.drone["command"][:INPUT_SIZE].copy()
        self.send(self._setup.controls.sender.message(u))

    def publish_command(self) -> None:
        """Publish the input that compiled code has given to the world."""
        u = self._row.drone["command"][:INPUT_SIZE].copy()
        command = self._setup.controls.sender.message(u)
        self._flier.port.publish(DRONE_TOPICS.command, command)

    def publish_reference(self) -> None:
        """Publish the full state that the drone flies."""
        flown = self._row.flown
        if flown is not None:
            self._flier.port.publish(DRONE_TOPICS.reference, flown)

    def _compute_command(self, now: float) -> Command | None:
        """Return the command of a controller in Python that flies what the drone wants."""
        row = self._row.drone
        state = self._row.state
        controls = self._setup.controls
        controller = controls.tracker
        reference: Reference = FullState(row["wanted"].copy())
        if row["controller"] == FlightControllerKind.FOLLOWER:
            assert controls.follower is not None  # noqa: S101 - the record says so
            controller = controls.follower
            reference = Acceleration(row["wanted"][6:9].copy(), row["wanted"][12])
        else:
            controls.trim.frozen = not row["learns_trim"]
        assert state is not None  # noqa: S101 - the drone ticks
        command = controller.command(state, reference, now)
        row["commanded"] = controller.acceleration
        if not np.linalg.norm(row["commanded"]) < LARGEST_ACCELERATION_NORM:
            name = type(controller).__name__
            self._notes.say(
                "acceleration",
                f"{name}.acceleration is {row['commanded'].tolist()}: others count on 0; "
                f"allowed: finite, below {LARGEST_ACCELERATION_NORM:g} m/s2",
            )
        return command

    def send(self, command: Command | None) -> None:
        """Send a command to the drone. None lets the drone continue as it does."""
        if command is None:
            return
        self._flier.body.send(command)
        if self._knows_commands:
            self.filter.commanded = command.flat
        self._flier.port.publish(DRONE_TOPICS.command, command)

    def steady(self) -> None:
        """After a failed tick, command the thrust of hovering and no body rates.

        This replaces the last command.
        """
        controls = self._setup.controls
        try:
            self.send(controls.sender.steady(controls.platform.weight))
        except Exception as error:  # noqa: BLE001 - it may be the link that has failed
            text = f"no command reaches the drone: {error_text(error)}"
            self._notes.say("link", text)
