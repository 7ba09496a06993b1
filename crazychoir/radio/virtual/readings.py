"""Log variables that the firmware model lacks, or that have other units there.

They concern the battery, the radio, decks and sensors.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from crazychoir.radio.protocol.compressed import pack_quaternion
from crazychoir.radio.virtual.flight import FlightService
from crazychoir.radio.virtual.memories import MemoryService
from crazychoir.radio.virtual.parameters import ParameterService
from crazychoir.radio.virtual.power import PowerManagement, battery_level
from crazychoir.simulation.onboard.onboard import Onboard

Readings = dict[str, Callable[[], float]]
"""Functions that return log variables, by name."""


@dataclass(frozen=True, slots=True)
class FixedReadings:
    """Log variables that never change."""

    free_range: float = 32767.0
    """mm: a range without an obstacle."""
    rssi: float = 40.0
    """-dBm: a drone two metres away."""
    lighthouse_status: float = 2.0
    """lighthouse.status: the position is known."""


FIXED_READINGS = FixedReadings()


class DroneParts(Protocol):
    """The parts of a drone that are logged."""

    onboard: Onboard
    power: PowerManagement
    flight: FlightService
    memories: MemoryService
    parameters: ParameterService
    received: int
    rates: tuple[float, float]

    @property
    def uptime(self) -> int:
        """ms since the drone was switched on."""
        ...

    @property
    def decks(self) -> tuple[str, ...]:
        """Decks on board."""
        ...

    @property
    def has_position_deck(self) -> bool:
        """Whether the drone carries the deck that measures its position."""
        ...

    def truth(self) -> Sequence[float]:
        """Return the true position, m, world."""
        ...


def make_readings(me: DroneParts) -> Readings:
    """Return the log variables by name, in the firmware's units."""
    return {
        **_battery_readings(me),
        **_link_readings(me),
        **_sensor_readings(me),
        **_estimator_readings(me),
        **_deck_readings(me),
    }


def _battery_readings(me: DroneParts) -> Readings:
    return {
        "pm.state": lambda: me.power.state(me.uptime),
        "pm.batteryLevel": lambda: battery_level(me.onboard.log("pm.vbat")),
    }


def _link_readings(me: DroneParts) -> Readings:
    external = {"x": 0, "y": 1, "z": 2, "qx": 3, "qy": 4, "qz": 5, "qw": 6}

    def said(k: int) -> float:
        return me.flight.told.last[k] if k < len(me.flight.told.last) else 0.0

    return {
        "radio.rssi": lambda: FIXED_READINGS.rssi,
        "radio.numRxUc": lambda: float(me.received & 0xFFFF),
        "radio.isConnected": lambda: 1.0,
        "crtp.rxRate": lambda: me.rates[0],
        "crtp.txRate": lambda: me.rates[1],
        "memTst.errCntW": lambda: float(me.memories.tester.errors),
        "supervisor.info": lambda: float(me.flight.info),
        **{f"locSrv.{name}": lambda k=k: said(k) for name, k in external.items()},  # type: ignore[misc]
        **{
            f"ext_pos.{name.upper()}": lambda k=k: said(k)  # type: ignore[misc]
            for name, k in list(external.items())[:3]
        },
    }


def _sensor_readings(me: DroneParts) -> Readings:
    on = me.onboard
    return {
        "baro.pressure": lambda: (
            1013.25 * max(1.0 - 2.25577e-5 * on.log("baro.asl"), 0.0) ** 5.25588
        ),
        "baro.temp": lambda: 25.0,
        "supervisor.accNorm": lambda: math.hypot(
            on.log("acc.x"), on.log("acc.y"), on.log("acc.z")
        ),
        "sys.testLogParam": lambda: me.parameters.read("system.testLogParam"),
        "stabilizer.intToOut": lambda: 1000.0,
        "stabilizer.rtStab": lambda: 1000.0,
        "kalman.rtUpdate": lambda: 1000.0,
        "kalman.rtPred": lambda: 100.0,
    }


def _estimator_readings(me: DroneParts) -> Readings:
    log = me.onboard.log

    def turned() -> float:
        q = me.onboard.estimate.q
        return float(pack_quaternion(q)) if np.all(np.isfinite(q)) else 0.0

    def scaled(name: str, factor: float) -> Callable[[], float]:
        return lambda: factor * log(name)

    axes = ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az")
    # The firmware's pitch is positive nose up, so its rate is that about -y.
    rates = {"Roll": ("x", 1.0), "Pitch": ("y", -1.0), "Yaw": ("z", 1.0)}
    degree = math.pi / 180.0
    return {
        "stateEstimateZ.quat": turned,
        **{
            f"stateEstimateZ.rate{name}": scaled(f"gyro.{axis}", sign * 1000.0 * degree)
            for name, (axis, sign) in rates.items()
        },
        **{
            f"ctrltargetZ.{name}": scaled(f"ctrltarget.{name}", 1000.0) for name in axes
        },
        "controller.actuatorThrust": scaled("controller.cmd_thrust", 1.0),
        "controller.accelz": scaled("acc.z", 1.0),
        "controller.ctr_yaw": scaled("controller.cmd_yaw", 1.0),
        **{
            f"controller.r_{name.lower()}": scaled(f"gyro.{axis}", sign * degree)
            for name, (axis, sign) in rates.items()
        },
    }


def _deck_readings(me: DroneParts) -> Readings:
    """Return the variables of decks.

    The range downwards, in mm, is the height above the floor; in other directions nothing is near.
    Without the deck a range is 0.
    """

    def far(side: str) -> float:
        return FIXED_READINGS.free_range if "bcMultiranger" in me.decks else 0.0

    def height() -> float:
        return (
            1000.0 * me.truth()[2] if {"bcFlow2", "bcZRanger2"} & set(me.decks) else 0.0
        )

    def seen(k: int) -> float:
        return me.truth()[k] if me.has_position_deck else 0.0

    return {
        **{
            f"range.{side}": lambda side=side: far(side)  # type: ignore[misc]
            for side in ("front", "back", "left", "right", "up")
        },
        "range.zrange": height,
        **{f"lighthouse.{axis}": lambda k=k: seen(k) for k, axis in enumerate("xyz")},  # type: ignore[misc]
        "lighthouse.status": lambda: (
            FIXED_READINGS.lighthouse_status * me.has_position_deck
        ),
        "motion.squal": lambda: 100.0 * ("bcFlow2" in me.decks),
        "motion.motion": lambda: 176.0 * ("bcFlow2" in me.decks),
    }
