"""Looks at a swarm from a process of its own, in whatever namespace: one JSON line a status or log line.

python observer.py SWARM.json
"""

import json
import secrets
import sys
from typing import Any

import msgspec

from crazychoir.bus.network.access import ACCESS_RULES
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.launch.network import choose_certificate_name, configure_observer
from crazychoir.runtime.clock import Clock, run_wall
from crazychoir.runtime.mailbox import Call
from crazychoir.runtime.supervisor import Supervisor


def say(clock: Clock, drone: int, topic: str, value: Any) -> None:
    plain = (
        msgspec.structs.asdict(value) if isinstance(value, msgspec.Struct) else value
    )
    print(  # noqa: T201
        json.dumps({"t": clock.now(), "drone": drone, topic: plain}),
        file=sys.stderr,
        flush=True,
    )


async def look(clock: Clock) -> None:
    config = SwarmConfig.load(sys.argv[1])
    host = choose_certificate_name(config)
    bus = Bus(
        clock,
        process=f"{ACCESS_RULES.observer_prefix}-{host}.{secrets.token_hex(4)}",
        host=host,
    )
    bus.port(PORT_ADDRESSES.first_observer + 1)
    for i in config.ids:
        for topic in (DRONE_TOPICS.status, DRONE_TOPICS.log):
            box = Call(
                clock,
                lambda value, age, i=i, topic=topic: say(clock, i, topic.name, value),
            )
            bus.subscribe(topic, i, PORT_ADDRESSES.first_observer + 1, box)
    link = configure_observer(bus, config)
    link.open()
    await Supervisor(clock, "observer").run([link])


if __name__ == "__main__":
    run_wall(look)
