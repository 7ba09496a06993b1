"""What a team solves by: the method, the network, and the seed."""

from dataclasses import dataclass, field

from crazychoir.routing.distributed.member import RoutingSettings
from crazychoir.routing.distributed.pickup_delivery import PLANNING_METHODS


@dataclass(frozen=True, slots=True)
class SolveOptions:
    """How a team of robots solves an instance."""

    method: str = PLANNING_METHODS[0]
    """Name of the distributed method."""
    loss: float = 0.0
    """Share of messages that are lost."""
    graph: str = "ring"
    """Name of the communication graph."""
    seed: int = 0
    """Seed of the graph and of the losses."""
    settings: RoutingSettings = field(default_factory=RoutingSettings)
    """Settings of the method."""
    burst: float | None = None
    """Mean number of messages that are lost in a row; None if losses are independent."""


DEFAULT_SOLVE_OPTIONS = SolveOptions()
