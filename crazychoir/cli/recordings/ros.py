"""crazychoir ros: publish a running swarm for RViz and other ROS 2 programs that use rmw_zenoh.

Experimental.
"""

from typing import TYPE_CHECKING, Annotated

import typer

from crazychoir.cli.operate.inspect import SwarmOption, run_as_observer
from crazychoir.launch import number_options as options

if TYPE_CHECKING:
    from crazychoir.launch.observer import Window

ROUTER_ENDPOINT = "tcp/127.0.0.1:7447"
"""Endpoint of `rmw_zenohd`."""


def ros(
    swarm: SwarmOption = None,
    connect: Annotated[
        str, typer.Option(help="Endpoint of `rmw_zenohd`, or of another Zenoh router.")
    ] = ROUTER_ENDPOINT,
    domain: Annotated[int, options.whole("ROS_DOMAIN_ID.", least=0, most=232)] = 0,
    rate: Annotated[
        float, options.real("Messages of each topic a second.", least=0.1, most=100.0)
    ] = 10.0,
    seconds: Annotated[float, options.seconds("How long, in s.")] = 3600.0,
    commands: Annotated[
        bool,
        typer.Option(help="Accept commands of every program on the ROS network."),
    ] = False,
) -> None:
    """Show a running swarm in ROS 2 (experimental).

    Publishes poses, paths, odometry, status, markers and transforms as
    rmw_zenoh does.
    """

    async def work(window: "Window") -> None:
        from crazychoir.bridges.live_swarm import LiveSwarm
        from crazychoir.bridges.ros_bridge import RosBridge, serve
        from crazychoir.bridges.ros_commands import RosCommands
        from crazychoir.bus.network.zenoh_session import OutsideSession

        if commands:
            window.require_operator()
        ids = await window.find()
        with OutsideSession(connect) as outside:
            bridge = RosBridge(outside, domain, ids)
            if not commands:
                await serve(window, bridge, ids, rate, seconds)
                return
            live = LiveSwarm(window)
            given = RosCommands(live, outside, bridge.node, ids)
            try:
                await serve(window, bridge, ids, rate, seconds)
            finally:
                given.close()
                live.close()

    run_as_observer(swarm, work)
