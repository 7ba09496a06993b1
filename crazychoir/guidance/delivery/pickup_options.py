"""[mission_options] of pickup and delivery: its keys, units, ranges and defaults. The reader checks with them."""

from typing import Annotated

from msgspec import Meta

from crazychoir.config.tables import Seconds, Table, Text
from crazychoir.routing.distributed.pickup_delivery import METHODS

Method = Annotated[
    str,
    Meta(
        pattern=rf"^({'|'.join(METHODS)})\Z",
        description=", ".join(METHODS),
        examples=[METHODS[0]],
    ),
]


class PickupOptions(Table, frozen=True, kw_only=True):
    """[mission_options].

    instance: a file, without one that of the demonstration;  method: how the integer plan is recovered, see
    PickupDelivery;  service_time: s at each stop, at least: where the instance says more, it holds.
    """

    instance: Text | None = None
    method: Method = METHODS[0]
    service_time: Seconds = 1.0
