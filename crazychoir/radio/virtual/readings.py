"""Log variables that the firmware model lacks, or that have other units there.

They concern the battery, the radio, decks and sensors.
"""

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from crazychoir.numerics.math3d import GRAVITY
from crazychoir.radio.protocol.compressed import compressed
from crazychoir.radio.virtual.flight import Flight
from crazychoir.radio.virtual.memories import Memories
from crazychoir.radio.virtual.parameters import Parameters
from crazychoir.radio.virtual.power import Power, level
from crazychoir.simulation.onboard.onboard import Onboard

Readings = dict[str, Callable[[], float]]
"""Functions that return log variables, by name."""
NOTHING_NEAR = 32767.0
"""mm: a range without an obstacle."""
RSSI = 40.0
"""-dBm: a drone two metres away."""
LH_OK = 2.0
"""lighthouse.status: the position is known."""


class Parts(Protocol):
    """The parts of a drone that are logged."""

    onboard: Onboard
    power: Power
    flight: Flight
    memories: Memories
    parameters: Parameters
    received: int
    rates: tuple[float, float]
    positioned: bool

    @property
    def uptime(self) -> int:
        """ms since the drone was switched on."""
        ...

    @property
    def decks(self) -> tuple[str, ...]:
        """Decks on board."""
        ...

    def truth(self) -> Sequence[float]:
        """Return the true position, m, world."""
        ...


def readings(me: Parts) -> Readings:
    """Return the log variables by name, in the firmware's units."""
    return {**_electric(me), **_linked(me), **_sensed(me), **_thought(me), **_decks(me)}


def _electric(me: Parts) -> Readings:
    return {
        "pm.state": lambda: me.power.state(me.uptime),
        "pm.batteryLevel": lambda: level(me.onboard.log("pm.vbat")),
        "pm.extVbat": lambda: 0.0,
        "pm.chargeCurrent": lambda: 0.0,
    }


def _linked(me: Parts) -> Readings:
    external = {"x": 0, "y": 1, "z": 2, "qx": 3, "qy": 4, "qz": 5, "qw": 6}

    def said(k: int) -> float:
        return me.flight.external[k] if k < len(me.flight.external) else 0.0

    return {
        "radio.rssi": lambda: RSSI,
        "radio.numRxUc": lambda: float(me.received & 0xFFFF),
        "radio.numRxBc": lambda: 0.0,
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


def _sensed(me: Parts) -> Readings:
    on = me.onboard
    return {
        "baro.asl": lambda: on.estimate.p[2],
        "baro.pressure": lambda: (
            1013.25 * max(1.0 - 2.25577e-5 * on.estimate.p[2], 0.0) ** 5.25588
        ),
        "baro.temp": lambda: 25.0,
        "supervisor.accNorm": lambda: math.hypot(
            on.log("acc.x"), on.log("acc.y"), on.log("acc.z")
        ),
        "sys.testLogParam": lambda: me.parameters.read("system.testLogParam"),
        "stabilizer.intToOut": lambda: 1000.0,
        "stabilizer.rtStab": lambda: 1000.0,
    }


def _thought(me: Parts) -> Readings:
    log = me.onboard.log

    def turned() -> float:
        q = me.onboard.estimate.q
        return float(compressed(q)) if np.all(np.isfinite(q)) else 0.0

    def scaled(name: str, factor: float) -> Callable[[], float]:
        return lambda: factor * log(name)

    axes = ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az")
    rates = {"Roll": "x", "Pitch": "y", "Yaw": "z"}
    degree = math.pi / 180.0
    return {
        "stateEstimateZ.quat": turned,
        **{
            f"stateEstimateZ.rate{name}": scaled(f"gyro.{axis}", 1000.0 * degree)
            for name, axis in rates.items()
        },
        **{
            f"ctrltargetZ.{name}": scaled(f"ctrltarget.{name}", 1000.0) for name in axes
        },
        "controller.actuatorThrust": scaled("controller.cmd_thrust", 1.0),
        "controller.accelz": scaled("stateEstimate.az", GRAVITY),
        "controller.ctr_yaw": scaled("controller.cmd_yaw", 1.0),
        **{
            f"controller.r_{name.lower()}": scaled(f"gyro.{axis}", degree)
            for name, axis in rates.items()
        },
    }


def _decks(me: Parts) -> Readings:
    """Return the variables of decks.

    The range downwards, in mm, is the height above the floor; in other directions nothing is near.
    Without the deck a range is 0.
    """

    def far(side: str) -> float:
        return NOTHING_NEAR if "bcMultiranger" in me.decks else 0.0

    def height() -> float:
        return (
            1000.0 * me.truth()[2] if {"bcFlow2", "bcZRanger2"} & set(me.decks) else 0.0
        )

    def seen(k: int) -> float:
        return me.truth()[k] if me.positioned else 0.0

    return {
        **{
            f"range.{side}": lambda side=side: far(side)  # type: ignore[misc]
            for side in ("front", "back", "left", "right", "up")
        },
        "range.zrange": height,
        **{f"lighthouse.{axis}": lambda k=k: seen(k) for k, axis in enumerate("xyz")},  # type: ignore[misc]
        "lighthouse.status": lambda: LH_OK * me.positioned,
        "motion.squal": lambda: 100.0 * ("bcFlow2" in me.decks),
        "motion.motion": lambda: 176.0 * ("bcFlow2" in me.decks),
        "motion.deltaX": lambda: 0.0,
        "motion.deltaY": lambda: 0.0,
    }
