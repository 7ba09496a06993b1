"""Six robots share a table of six tasks, which is refilled as they complete tasks.

Each task is done by a robot that is allowed to do it.

crazychoir run task_assignment --fast --loss 0.2
"""

from crazychoir import SwarmConfig
from crazychoir.guidance.tasks.assignment_hooks import (
    AssignmentHooks,
    AssignmentOptions,
)
from crazychoir.guidance.tasks.task_assignment import (
    TaskAssignmentGuidance,
    TeamAssignment,
)

Options = AssignmentOptions
hooks = AssignmentHooks()
swarm = hooks.swarm
check = hooks.check
report = hooks.report
picture = hooks.picture


def guidance(i: int, config: SwarmConfig) -> TaskAssignmentGuidance:
    """Return the guidance of robot i."""
    generations = hooks.given(config).generations
    return TaskAssignmentGuidance(
        TeamAssignment(lambda count: hooks.drawn(config, count), generations)
    )
