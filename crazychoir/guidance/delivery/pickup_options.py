"""[mission_options] of pickup and delivery: keys, units, ranges and defaults.

The reader checks with them.
"""

from typing import Annotated

from msgspec import Meta

from crazychoir.config.tables import Seconds, SwarmTable, Text
from crazychoir.routing.distributed.pickup_delivery import PLANNING_METHODS

Method = Annotated[
    str,
    Meta(
        pattern=rf"^({'|'.join(PLANNING_METHODS)})\Z",
        description=", ".join(PLANNING_METHODS),
        examples=[PLANNING_METHODS[0]],
    ),
]


class PickupOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    instance: Text | None = None
    """File of the instance. None: the instance of the demonstration."""
    method: Method = PLANNING_METHODS[0]
    """How the integer plan is recovered, see PickupDelivery."""
    service_time: Seconds = 1.0
    """s at each stop, at least. A longer time of the instance holds."""
