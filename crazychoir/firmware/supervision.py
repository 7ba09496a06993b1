"""The states of the firmware's supervisor, and the bits by which it tells them."""

from typing import NamedTuple


class SupervisorStates(NamedTuple):
    """States of the firmware's supervisor, numbered as in the firmware."""

    not_initialised: int = 0
    """The firmware has not started."""
    checks_not_passed: int = 1
    """The checks before flight fail."""
    checks_passed: int = 2
    """The checks before flight pass; the motors are locked."""
    arming: int = 3
    """The motors are being armed."""
    ready: int = 4
    """The drone may fly."""
    flying: int = 5
    """The drone flies."""
    landed: int = 6
    """The drone has landed."""
    reset: int = 7
    """The supervisor starts anew."""
    level_out: int = 8
    """Set-points are missing: the drone levels out."""
    free_fall: int = 9
    """The motors are off for good; the drone is locked next."""
    locked: int = 10
    """The motors are locked until the drone is switched off."""
    crashed: int = 11
    """The drone has crashed."""


SUPERVISOR_STATES = SupervisorStates()


STATE_NAMES = (
    "not initialised",
    "pre-flight checks not passed",
    "pre-flight checks passed",
    "arming",
    "ready to fly",
    "flying",
    "landed",
    "reset",
    "warning: level out",
    "exception: free fall",
    "locked",
    "crashed",
)
"""Name of each state, in the order of `SupervisorStates`."""


class SupervisorBits(NamedTuple):
    """Bits of supervisor.info, which the supervisor writes at 25 Hz."""

    can_arm: int = 1 << 0
    """The drone may be armed."""
    armed: int = 1 << 1
    """The drone is armed."""
    auto_arm: int = 1 << 2
    """The drone arms itself."""
    can_fly: int = 1 << 3
    """The drone may fly."""
    flying: int = 1 << 4
    """The drone flies, or levels out."""
    tumbled: int = 1 << 5
    """The drone lies on its back."""
    locked: int = 1 << 6
    """The firmware has locked the drone."""
    crashed: int = 1 << 7
    """The drone has crashed."""
    planned: int = 1 << 8
    """The planner flies or lands the drone."""
    plan_ended: int = 1 << 9
    """The plan has ended."""
    plan_disabled: int = 1 << 10
    """The planner gives no set-points."""
    deck_fault: int = 1 << 11
    """A deck is faulty."""


SUPERVISOR_BITS = SupervisorBits()
