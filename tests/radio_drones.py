"""One drone of a dongle's owner, with a connection that keeps what it is given."""

import asyncio
import math
from pathlib import Path

import numpy as np

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.drone.own_estimate import LOG_NAMES
from crazychoir.radio.drone.radio_drone import RadioDrone, SharedRadio
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.protocol.crtp import PACKET_FORMS
from crazychoir.types import XYZ, Pose

READY = SUPERVISOR_BITS.can_fly | SUPERVISOR_BITS.auto_arm


STOP, LINE, LAND = (
    XYZ(verb, np.array([1.0, 0.0, 1.0, 0.0, 2.0])) for verb in ("stop", "line", "land")
)


class Kept:
    """A connection that keeps the heads of what it is given, in order."""

    def __init__(self) -> None:
        self.sent: list[tuple[int, int, int]] = []
        self.silence, self.latency, self.answered, self.rssi = 0.0, 0.01, 1.0, math.nan

    def _keep(self, packet) -> None:
        self.sent.append(
            (packet.port, packet.channel, packet.data[0] if packet.data else -1)
        )

    def send(self, packet) -> None:
        self._keep(packet)

    def newest(self, kind, packet) -> None:
        self._keep(packet)

    def urgent(self, packets) -> None:
        for packet in packets:
            self._keep(packet)

    def forget(self, kind) -> None:
        """Nothing waits here."""


def head(form: str) -> tuple[int, int, int]:
    one = PACKET_FORMS[form]
    return one.port, one.channel, one.head[0]


def made(
    clock, kind: str = "xyz", rate: float = 50.0, pose: str = "mocap", **radio
) -> tuple[RadioDrone, Kept]:
    row = {"id": 0, "home": [0, 0, 0], "uri": "udp://127.0.0.1:19850", "pose": pose}
    tables = {"control": {"sender": kind}, "radio": {"log_rate": 50.0} | radio}
    config = SwarmConfig.of({"name": "a", "drones": [row]} | tables)
    bus = Bus(clock)
    bus.port(PORT_ADDRESSES.body_offset)
    drone = RadioDrone(
        bus, config, 0, kind, rate, SharedRadio(TableOfContents(Path("nowhere")))
    )
    drone.handler.thrust = 136_531.0
    drone.link.connection = kept = Kept()
    return drone, kept


def tell(drone: RadioDrone, supervisor: int, at: int | None = None) -> None:
    """Its log has come, of `at` ms by its own clock, None: of now."""
    at = 1000 + round(1000 * drone.clock.now()) if at is None else at
    values = dict.fromkeys(LOG_NAMES.estimate, 0.0) | {
        "pm.vbat": 4.0,
        "supervisor.info": float(supervisor),
    }
    drone.estimate.take_log(values | {LOG_NAMES.estimate[6]: 3 << 30}, at)


def seen(drone: RadioDrone, q=(0.0, 0.0, 0.0, 1.0)) -> None:
    """The cameras have."""
    drone.view.see(Pose(np.array([0.0, 0.0, 0.0, *q])), 0.0)


class Slow(Kept):
    """A connection that asks in vain, until it is told to go on."""

    def __init__(self, uri: str = "") -> None:
        super().__init__()
        self.uri, self.dongle_failure, self.failure = uri, "", ""
        self.goes_on, self.begun, self.version = asyncio.Event(), 0, 12

    async def open(self, seconds: float, tables: float) -> None:
        """At once."""

    async def close(self) -> None:
        """At once."""

    async def reset_logs(self, seconds: float) -> None:
        await self.goes_on.wait()

    async def log(self, name, variables, period, data, seconds) -> None:
        self.begun += 1
        await self.goes_on.wait()


def up(z: float) -> Pose:
    return Pose(np.array([0.0, 0.0, z, 0.0, 0.0, 0.0, 1.0]))
