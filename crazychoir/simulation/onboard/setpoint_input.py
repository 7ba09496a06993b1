"""The set-points that one drone gets, in SI units."""

import math
from collections.abc import Sequence

import numpy as np

from crazychoir.platforms import Firmware
from crazychoir.simulation.onboard import commander
from crazychoir.simulation.onboard.commander import SETPOINT_PRIORITIES
from crazychoir.simulation.onboard.record import EntryPoints, Fleet
from crazychoir.simulation.onboard.units import (
    FULL_THRUST_COMMAND,
    convert_thrust_to_raw,
)
from crazychoir.types import Vec

_commander = EntryPoints(commander)


class SetpointInput:
    """Gives set-points to the commander of one drone.

    A method returns True if the commander has accepted the set-point; it is refused if its priority
    is too low or a number is not finite.

    rows: memory of all drones
    row: row of this drone
    firmware: figures of its firmware
    """

    def __init__(self, rows: Fleet, row: int, firmware: Firmware) -> None:
        self._rows = rows
        self._row = row
        self._firmware = firmware

    def rpyt_raw(
        self,
        roll: float,
        pitch: float,
        yaw: float,
        thrust: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point with the numbers of an RPYT packet.

        roll: deg or deg/s
        pitch: deg or deg/s, positive nose up
        yaw: deg, or deg/s with inverted sign
        thrust: 0..65535
        """
        ok = math.isfinite(roll + pitch + yaw + thrust)
        return ok and bool(
            _commander.rpyt(self._rows, self._row, roll, pitch, yaw, thrust, priority)
        )

    def fpqr(self, thrust: float, p: float, q: float, r: float) -> bool:
        """Give a set-point of thrust N and body rates rad/s.

        It needs flightmode.stabModeRoll = .stabModePitch = .stabModeYaw = 0.
        """
        return self._give(thrust, p, q, r)

    def frpy(self, thrust: float, roll: float, pitch: float, yaw_rate: float) -> bool:
        """Give a set-point of thrust, roll, pitch and yaw rate.

        It needs flightmode.stabModeRoll = .stabModePitch = 1 and .stabModeYaw = 0.
        thrust: N
        roll: rad
        pitch: rad, positive nose down
        yaw_rate: rad/s
        """
        return self._give(thrust, roll, pitch, yaw_rate)

    def _give(self, *numbers: float) -> bool:
        u = np.array(numbers, dtype=np.float64)
        return bool(_commander.give_thrust_setpoint(self._rows, self._row, u))

    def stream(self, u: Vec) -> bool:
        """Unlock the thrust if it is locked, and give a set-point of fpqr or frpy.

        u: (4,): the arguments of fpqr, or of frpy
        """
        # The entry point does not check the type of the array.
        flat = np.ascontiguousarray(u, dtype=np.float64)
        return bool(_commander.stream_thrust_setpoint(self._rows, self._row, flat))

    def _thrust(self, newtons: float) -> float:
        raw = convert_thrust_to_raw(newtons, self._firmware)
        return (
            min(max(raw, 0.0), FULL_THRUST_COMMAND) if math.isfinite(raw) else math.nan
        )

    def stop_setpoint(self, priority: int = SETPOINT_PRIORITIES.crtp) -> bool:
        """Give the null set-point: no thrust, all modes disabled."""
        return bool(_commander.nothing(self._rows, self._row, priority))

    def velocity(
        self,
        v: Vec | Sequence[float],
        yaw_rate: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of velocity v (3,) m/s, world, and yaw rate rad/s."""
        x, y, z = v
        ok = math.isfinite(x + y + z + yaw_rate)
        return ok and bool(
            _commander.velocity(
                self._rows, self._row, x, y, z, math.degrees(yaw_rate), priority
            )
        )

    def hover(
        self,
        ahead: float,
        left: float,
        yaw_rate: float,
        z: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of horizontal velocity in the axes of the heading, yaw rate and height.

        ahead: m/s, along the heading
        left: m/s, to the left of the heading
        yaw_rate: rad/s
        z: m, world
        priority: priority of the sender, from SETPOINT_PRIORITIES
        Returns False if the set-point is refused: a number is not finite, or a sender with a higher
        priority is in control.
        """
        ok = math.isfinite(ahead + left + yaw_rate + z)
        return ok and bool(
            _commander.hover(
                self._rows, self._row, ahead, left, math.degrees(yaw_rate), z, priority
            )
        )

    def z_distance(
        self,
        roll: float,
        pitch: float,
        yaw_rate: float,
        z: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of roll, pitch, yaw rate and height.

        roll: rad
        pitch: rad, positive nose down
        yaw_rate: rad/s
        z: m, world
        """
        ok = math.isfinite(roll + pitch + yaw_rate + z)
        r = math.degrees(roll)
        p = -math.degrees(pitch)
        w = math.degrees(yaw_rate)
        return ok and bool(
            _commander.z_distance(self._rows, self._row, r, p, w, z, priority)
        )

    def altitude_hold(
        self,
        roll: float,
        pitch: float,
        yaw_rate: float,
        climb: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of roll, pitch, yaw rate and vertical speed.

        roll: rad
        pitch: rad, positive nose down
        yaw_rate: rad/s
        climb: m/s, upwards
        """
        ok = math.isfinite(roll + pitch + yaw_rate + climb)
        r = math.degrees(roll)
        p = -math.degrees(pitch)
        w = math.degrees(yaw_rate)
        return ok and bool(
            _commander.altitude_hold(self._rows, self._row, r, p, w, climb, priority)
        )

    def manual(
        self,
        thrust: float,
        roll: float,
        pitch: float,
        yaw_rate: float,
        rates: bool = False,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of thrust, roll, pitch and yaw rate without the thrust lock.

        thrust: N
        roll: rad, or rad/s if rates is True
        pitch: rad, or rad/s if rates is True
        yaw_rate: rad/s
        """
        ok = math.isfinite(thrust + roll + pitch + yaw_rate)
        r = math.degrees(roll)
        p = -math.degrees(pitch)
        w = math.degrees(yaw_rate)
        raw = self._thrust(thrust)
        return ok and bool(
            _commander.manual(
                self._rows, self._row, r, p, w, raw, float(rates), priority
            )
        )

    def position(
        self,
        p: Vec | Sequence[float],
        yaw: float,
        priority: int = SETPOINT_PRIORITIES.crtp,
    ) -> bool:
        """Give a set-point of position p (3,) m, world, and heading rad."""
        x, y, z = p
        ok = math.isfinite(x + y + z + yaw)
        return ok and bool(
            _commander.position(
                self._rows, self._row, x, y, z, math.degrees(yaw), priority
            )
        )

    def full_state(self, s: Vec, priority: int = SETPOINT_PRIORITIES.crtp) -> bool:
        """Give a full state s (16,) = p m, v m/s, a m/s2 world, q body to world, w rad/s body."""
        ok = math.isfinite(float(np.sum(s)))
        return ok and bool(_commander.full_state(self._rows, self._row, s, priority))
