"""crazychoir: swarms of Crazyflie quadrotors that optimise and fly together, without ROS.

The names below are imported at their first use. Numerical libraries and kernels take 1 s to import.
The help of the command line, or a program that needs only one room, does not spend that second.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from crazychoir.files import user_folders

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.errors import CrazyChoirError
    from crazychoir.guidance.delivery.pickup_delivery import PDVRPGuidance
    from crazychoir.guidance.feedback import CFDistributedFeedback
    from crazychoir.guidance.guidance import CFGuidance
    from crazychoir.team.communicator import Communicator
    from crazychoir.team.graph import Graph, GraphSequence
    from crazychoir.team.round import Round
    from crazychoir.types import (
        FPQR,
        Acceleration,
        FullState,
        Goto,
        PerNeighbor,
        Pose,
        State,
        Velocity,
    )

__all__ = [
    "FPQR",
    "Acceleration",
    "CFDistributedFeedback",
    "CFGuidance",
    "Communicator",
    "CrazyChoirError",
    "FullState",
    "Goto",
    "Graph",
    "GraphSequence",
    "PDVRPGuidance",
    "PerNeighbor",
    "Pose",
    "Round",
    "State",
    "SwarmConfig",
    "Velocity",
]
"""The public names."""
_ROOM_OF = {
    "CrazyChoirError": "errors",
    "CFDistributedFeedback": "guidance.feedback",
    "CFGuidance": "guidance.guidance",
    "PDVRPGuidance": "guidance.delivery.pickup_delivery",
    "Communicator": "team.communicator",
    "SwarmConfig": "config.swarm_config",
    "Graph": "team.graph",
    "GraphSequence": "team.graph",
    "Round": "team.round",
    **dict.fromkeys(
        (
            "FPQR",
            "Acceleration",
            "FullState",
            "Goto",
            "PerNeighbor",
            "Pose",
            "State",
            "Velocity",
        ),
        "types",
    ),
}
"""Public name: the module that defines it, below `crazychoir`."""

user_folders.prepare_matplotlib()  # before a mission imports it

if not TYPE_CHECKING:  # hidden: a type checker would take every name for a public one

    def __getattr__(name: str) -> object:
        """Import a public name at its first use, and return it; `__version__` is the version
        (PEP 562).
        """
        if name == "__version__":
            from importlib.metadata import version

            return version(__name__)
        if name not in _ROOM_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = globals()[name] = getattr(
            import_module(f"{__name__}.{_ROOM_OF[name]}"), name
        )
        return value

    def __dir__() -> list[str]:
        return sorted([*globals(), *__all__])
