"""The states of the planner on board."""

from typing import NamedTuple


class PlannerStates(NamedTuple):
    """States of the planner, numbered as in the firmware (planner.h)."""

    idle: int = 0
    """There is no plan; the motors are off while the planner is in control."""
    flying: int = 1
    """A plan is being flown that does not end with a landing."""
    landing: int = 3
    """A landing is being flown; the planner is idle at its end."""
    disabled: int = 4
    """The planner gives no set-points, because those of its plan are no numbers."""


PLANNER_STATES = PlannerStates()
