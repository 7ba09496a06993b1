"""One process of a swarm in real time: its drones, its connection to the network, its signals."""

import logging
import signal
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from crazychoir.agent.agent import Agent, AgentProcess
from crazychoir.agent.worlds import WorldProcess
from crazychoir.bus.network.public_topics import PublicCopies
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.network.zenoh_session import SessionEndpoints
from crazychoir.config.access import access_of
from crazychoir.config.addresses import PROCESS_NUMBERS, Addresses
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused
from crazychoir.guidance.mission import Mission
from crazychoir.launch.process.owner import (
    ProcessIdentity,
    introduce_process,
    run_owner,
)
from crazychoir.launch.process.signals import REPEAT_TIME, SIGNAL_NAMES
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND, Clock, run_wall
from crazychoir.runtime.watchdog import Watchdog
from crazychoir.runtime.worker_thread import add_signal_handler

log = logging.getLogger(__name__)
ServiceFactory = Callable[[Agent], Sequence[Actor]]
"""Returns further actors for the process of an agent."""


def make_no_services(agent: Agent) -> Sequence[Actor]:
    """Return no further actors."""
    return ()


def run_agent(
    config: SwarmConfig,
    mission: Mission,
    ids: tuple[int, ...],
    listen: str | None,
    connect: list[str] | None,
    make_services: ServiceFactory = make_no_services,
) -> dict[str, Any]:
    """Fly these drones in real time, over Zenoh; return their results and the counters.

    config: the swarm
    mission: its mission
    ids: ids of the drones
    listen: Zenoh endpoint to listen on; None for that of the swarm file
    connect: Zenoh endpoints to connect to; None for those of the swarm file
    make_services: returns further actors that run in this process, such as a benchmark's meter
    """

    async def main(clock: Clock) -> dict[str, Any]:
        me = ProcessIdentity.draw(str(ids[0]), ids[0], config.drone(ids[0]).host)
        agent = Agent(
            clock,
            config,
            mission,
            ids,
            process=AgentProcess(me.name, me.incarnation, is_alone=False),
        )
        _obey_signals(clock, agent)  # before others can find this process and end it
        link = _make_process_link(agent, config, ids, listen, connect)
        link.open()
        agent.alarm = link.alarm
        others_hang_too = bool(agent.owned) or len(ids) > 1
        agent.watchdog = watchdog = Watchdog(clock, agent.stalled, soon=others_hang_too)
        watchdog.start()
        agent.services += [link, PublicCopies(agent.bus, link.session, ids)]
        agent.services += make_services(agent)
        try:
            results = await agent.run()
            await clock.sleep(0.3)  # time to send the last statuses
        finally:
            watchdog.stop()
        return {
            "results": results,
            "network": asdict(link.counters),
            "worst_put_s": link.counters.worst_put_s,
            "late_s": watchdog.worst,
            "presence": {i: drone.barrier.history for i, drone in agent.drones.items()},
        }

    return run_wall(main)


def _make_process_link(
    agent: Agent,
    config: SwarmConfig,
    ids: tuple[int, ...],
    listen: str | None,
    connect: list[str] | None,
) -> ZenohLink:
    """Return the link: listen at the endpoint of the lowest drone, connect to every lower process.

    So there is exactly one connection between two processes.
    """
    addresses = Addresses(config)
    host = addresses.endpoint(ids[0]).rsplit(":", 1)[0]
    own = f"{host}:{config.base_port + ids[0]}"
    lower = [
        endpoint
        for process, endpoint in addresses.endpoints().items()
        if process < ids[0]
    ]

    def on_token(drones: list[int], there: bool) -> None:
        for drone in agent.drones.values():
            for j in drones:
                (
                    drone.barrier.monitor.token_back
                    if there
                    else drone.barrier.monitor.token_gone
                )(j)

    def on_refused(refused: Refused) -> None:
        agent.refuse(refused)

    return ZenohLink(
        agent.bus,
        introduce_process(config, agent.incarnation),
        SessionEndpoints(
            listen=[listen or own],
            connect=lower if connect is None else connect,
            routers=[] if listen or connect else addresses.routers,
            lease=config.lease,
            remote_processes=addresses.count_remote(config.drone(ids[0]).host),
        ),
        access=access_of(
            config, agent.bus.host, *filter(None, [listen, *(connect or ())])
        ),
        on_token=on_token,
        on_refused=on_refused,
    )


def run_world(config: SwarmConfig, listen: str | None) -> dict[str, Any]:
    """Own the simulated world of a swarm in real time, over Zenoh; return a report."""

    async def main(clock: Clock) -> dict[str, Any]:
        me = ProcessIdentity.draw("world", PROCESS_NUMBERS.world, config.world.host)
        world = WorldProcess(clock, config, me.name, me.host, me.incarnation)
        figures = await run_owner(config, world, me, listen)
        return world.report() | figures

    return run_wall(main)


def run_radios(config: SwarmConfig, dongle: int, listen: str | None) -> dict[str, Any]:
    """Own a dongle and its links in real time, over Zenoh; return a report.

    Raises Refused if another process owns the dongle.
    """
    # Agents, which share this module, need no radio.
    from crazychoir.radio.link.ownership import own_dongle
    from crazychoir.radio.owner import RadioProcess

    number = PROCESS_NUMBERS.first_dongle - dongle
    host = config.topology.dongle_host(dongle)

    async def main(clock: Clock) -> dict[str, Any]:
        me = ProcessIdentity.draw(f"dongle{dongle}", number, host)
        radios = RadioProcess(clock, config, dongle, me.name, me.host, me.incarnation)
        endpoints = Addresses(config).endpoints()
        cameras = endpoints.get(PROCESS_NUMBERS.motion_capture)
        connect = [] if cameras is None else [cameras]
        figures = await run_owner(config, radios, me, listen, connect, is_watched=False)
        return radios.report() | figures

    with own_dongle(config, dongle):
        return run_wall(main)


def _obey_signals(clock: Clock, agent: Agent) -> None:
    """Land at the first signal, warn at a second within 2 s, cut the motors at a third.

    SIGHUP only lands. It means that the terminal or the parent has ended. A parent with many
    threads sends it once a thread, so a repetition does not mean that a user insists.
    """
    times: list[int] = []

    def on_signal(number: int) -> None:
        if number == signal.SIGHUP:
            agent.land_all("SIGHUP: landing")
            return
        times.append(clock.now_ns())
        recent = [t for t in times if t > times[-1] - REPEAT_TIME * NS_PER_SECOND]
        if len(recent) >= 3:
            agent.cut_all("third signal")
        elif len(recent) == 2:
            log.warning("landing; once more within %g s cuts the motors", REPEAT_TIME)
        else:
            agent.land_all(f"{SIGNAL_NAMES[number]}: landing")

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        add_signal_handler(number, on_signal, number)
