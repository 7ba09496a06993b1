"""Look after drones that do not fly: their battery and state, a restart, and switching them off."""

import asyncio
import math
from dataclasses import dataclass
from enum import IntEnum

import cflib.crtp
from cflib.utils.power_switch import PowerSwitch

from crazychoir.errors import LinkFailed, Refused, error_text
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio import checks
from crazychoir.radio.link import drivers
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.link.firmware import ConnectedFirmware
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.runtime.clock import Clock

HEALTH_VARIABLES = ("pm.vbat", "supervisor.info")
"""Log variables of a drone's condition."""
HEALTH_PERIOD = 0.1  # s between two logs
HEALTH_DEADLINE = 2.0  # s: time in which the drone must tell its condition
RESTART_PAUSE = 1.0  # s between switching the main processor off and on


class PowerAction(IntEnum):
    """What happens to the power of a drone."""

    RESTART = 0
    """Its main processor and its decks are switched off and on."""
    OFF = 1
    """It is switched off, as by its button; only its button switches it on."""


@dataclass(frozen=True)
class DroneCondition:
    """What a drone on the ground tells about itself."""

    volts: float
    """V of its battery, at rest."""
    release: str
    """Release of its firmware."""
    is_flying: bool
    """Whether its motors turn, or have turned within 2 s."""
    problems: list[str]
    """Why its supervisor does not let it fly."""


async def read_condition(
    clock: Clock, uri: str, contents: TableOfContents, deadline: float
) -> DroneCondition:
    """Connect a drone, and return its condition.

    deadline: s until it is connected
    Raises LinkFailed if the link fails.
    """
    connection = Connection(clock, uri, contents)
    told: asyncio.Future[dict[str, float]] = asyncio.get_running_loop().create_future()

    def note(values: dict[str, float], at: int) -> None:
        if not told.done():
            told.set_result(values)

    try:
        await connection.open(deadline)
        await connection.log(
            "health", HEALTH_VARIABLES, HEALTH_PERIOD, note, HEALTH_DEADLINE
        )
        async with asyncio.timeout(HEALTH_DEADLINE):
            values = await told
        release = await ConnectedFirmware(connection).release()
    except TimeoutError:
        raise LinkFailed(uri, "it does not tell its condition") from None
    finally:
        await connection.close()
    supervisor = int(values["supervisor.info"])
    return DroneCondition(
        values.get("pm.vbat", math.nan),
        release,
        bool(supervisor & SUPERVISOR_BITS.flying),
        checks.supervisor_problems(supervisor),
    )


async def switch_power(
    clock: Clock,
    uri: str,
    contents: TableOfContents,
    deadline: float,
    action: PowerAction,
) -> DroneCondition:
    """Restart a drone, or switch it off; return its condition before.

    deadline: s until it is connected
    Raises LinkFailed if the link fails. Raises Refused while the drone flies.
    """
    before = await read_condition(clock, uri, contents, deadline)
    if before.is_flying:
        raise Refused(uri, "it flies: land it first")
    await asyncio.to_thread(_switch, uri, action == PowerAction.OFF)
    if action == PowerAction.RESTART:
        await clock.sleep(RESTART_PAUSE)
        await asyncio.to_thread(_power_up, uri)
    return before


def find_drones() -> list[str]:
    """Return the uris at which drones with the address of a new one, or virtual drones, answer."""
    drivers.register_drivers()
    return [str(uri) for uri, *_ in cflib.crtp.scan_interfaces()]


def _switch(uri: str, is_all: bool) -> None:
    """Switch the drone off; is_all: with the chip of its radio."""
    drivers.register_drivers()
    try:
        switch = PowerSwitch(uri)
        if is_all:
            switch.platform_power_down()
        else:
            switch.stm_power_down()
        switch.close()
    except Exception as error:
        raise LinkFailed(uri, error_text(error)) from error


def _power_up(uri: str) -> None:
    try:
        switch = PowerSwitch(uri)
        switch.stm_power_up()
        switch.close()
    except Exception as error:
        raise LinkFailed(uri, error_text(error)) from error
