"""Pickup and delivery in flight: the team plans again when tasks or drones come and go.

Tasks appear and are cancelled. Drones are lost and join.

crazychoir run online_delivery --fast --loss 0.2
"""

from crazychoir import SwarmConfig
from crazychoir.guidance.delivery.online_delivery import OnlinePDVRPGuidance
from crazychoir.guidance.delivery.online_hooks import OnlineHooks
from crazychoir.guidance.delivery.online_setup import DeliveryOptions

Options = DeliveryOptions
hooks = OnlineHooks()
swarm = hooks.swarm
check = hooks.check
report = hooks.report
picture = hooks.picture


def guidance(i: int, config: SwarmConfig) -> OnlinePDVRPGuidance:
    """Return the guidance of robot i, with its own part of the instance."""
    own = hooks.instance(config).local(i)
    return OnlinePDVRPGuidance(
        own, hooks.known(config), hooks.events(config), hooks.options(config)
    )
