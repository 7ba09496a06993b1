"""Pickup and delivery: the team shares out the goods, then each drone flies its part of the plan.

One distributed mixed-integer program gives the plan.

crazychoir run pickup_delivery --loss 0.2
"""

from pathlib import Path

from crazychoir import PDVRPGuidance, SwarmConfig
from crazychoir.guidance.delivery.pickup_hooks import PickupHooks
from crazychoir.guidance.delivery.pickup_setup import PickupOptions

DEMO_INSTANCE = Path(__file__).parent / "data" / "lab6.json"
"""The instance of the demonstration."""

Options = PickupOptions
hooks = PickupHooks(DEMO_INSTANCE)
swarm = hooks.swarm
check = hooks.check
report = hooks.report
picture = hooks.picture
compile = hooks.compile


def guidance(i: int, config: SwarmConfig) -> PDVRPGuidance:
    """Return the guidance of robot i, with its own part of the instance."""
    own = hooks.instance(config).local(i)
    options = hooks.given(config)
    return PDVRPGuidance(own, options.method, options.service_time, options.settings)
