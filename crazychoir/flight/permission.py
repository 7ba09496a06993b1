"""What one drone may do: its mode, and which of guidance, operator and safety may move it."""

from crazychoir.flight.batch import DroneRow
from crazychoir.safety.rules.modes import (
    FOLLOW_MODE,
    GUIDED_MODES,
    HELD_TEXT,
    HOVER_MODE,
    MOTORS_OFF_MODES,
    Mode,
    ModeEvent,
    get_next_mode,
    get_refusal,
)
from crazychoir.types import Point


class Permission:
    """Holds the mode of one drone and the permissions to move it.

    row: of the drone in its batch
    awaits_start: whether the mission waits for the operator's start
    """

    def __init__(self, row: DroneRow, awaits_start: bool) -> None:
        self._row = row
        self.commanded = False
        """Whether the flight, planned or about to begin, is the operator's.

        Guidance does not end such a flight.
        """
        row.drone["awaits_start"] = awaits_start
        self.unguided = ""
        """Why guidance is gone during the flight; empty while it is there."""
        self.cut_for = ""
        """Why the motors were cut for good; empty if they were not."""
        self.takes_over = False
        """Whether others fly the drone: it gets no commands until it is seen, and lands then."""
        self.started_at: Point | None = None
        """(3,) m, where the drone stood when it took off first."""

    @property
    def mode(self) -> Mode:
        """The mode of the drone."""
        return self._row.mode

    @property
    def held(self) -> bool:
        """Whether the operator holds the drone."""
        return bool(self._row.drone["is_held"])

    @property
    def awaits_start(self) -> bool:
        """Whether the mission waits for the operator's start; until then guidance moves nothing."""
        return bool(self._row.drone["awaits_start"])

    @property
    def airborne(self) -> bool:
        """Whether the motors may be running."""
        return self.mode not in MOTORS_OFF_MODES

    @property
    def obeys(self) -> bool:
        """Whether guidance moves the drone: in the air, not held, not waiting for its operator."""
        return self.mode in GUIDED_MODES and not (self.held or self.awaits_start)

    @property
    def steerable(self) -> bool:
        """Whether the operator may fly the drone: it is in the air, and its mission waits.

        A mission waits while the drone is held, and before the operator has started the mission.
        After guidance has failed, the operator cannot fly the drone.
        """
        return (
            self.mode in (HOVER_MODE, FOLLOW_MODE)
            and (self.held or self.awaits_start)
            and not self.unguided
        )

    def change(self, event: ModeEvent) -> None:
        """Change the mode as the table of modes says for this event."""
        self._row.mode = get_next_mode(self.mode, event)

    def skip_take_off(self) -> None:
        """Enter the mode of a flying drone: this robot does not take off."""
        self._row.mode = HOVER_MODE

    def refuses(self, command: ModeEvent) -> str:
        """Return why the drone cannot do what its operator commands, in this mode.

        Returns an empty text if it can.
        """
        return get_refusal(self.mode, command)

    def hold(self, on: bool) -> None:
        """Let the operator hold the drone, or let it go; this ends the operator's flight."""
        self._row.drone["is_held"] = on
        self.commanded = False

    def await_operator(self) -> None:
        """Let the operator fly the drone, until a start."""
        self._row.drone["awaits_start"] = 1

    def start(self) -> None:
        """Let the mission fly the drone."""
        self._row.drone["awaits_start"] = 0
        self.commanded = False

    def may_fly(self, by_operator: bool) -> bool:
        """Return whether a flight may begin now, as far as operator and guidance are concerned.

        From a command of the operator until a hold, the flight counts as the operator's.

        by_operator: whether the operator wants the flight
        """
        if not (self.steerable if by_operator else self.obeys):
            return False
        self.commanded = by_operator
        return True

    def explain_no_take_off(
        self, is_stopped: bool, latched: str, problems: list[str]
    ) -> tuple[str, str]:
        """Return the rule that forbids a take-off now, and its text; both empty if none does.

        is_stopped: whether an emergency stop is in force
        latched: why a rule of the safety table acts for good; empty if none does
        problems: of the body
        """
        if is_stopped:
            return (
                "stop",
                "emergency stop in force: no take-off until `crazychoir stop --clear`",
            )
        if why := self.cut_for or latched:
            return "again", f"{why}: no take-off until its agent is started again"
        if problems:
            return "unfit", f"{'; '.join(problems)}: no take-off"
        if self.held:
            return "held", f"{HELD_TEXT}: no take-off until it is let go"
        return "", ""
