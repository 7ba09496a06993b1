"""Apply the [drones.calibration] of a drone to its platform: its true body, and what its controller knows."""

from dataclasses import replace

import numpy as np

from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.radio_checks import has_radio
from crazychoir.config.tables import CalibrationTable, DroneTable, MotorsTable
from crazychoir.errors import ConfigError
from crazychoir.platforms import (
    Battery,
    BodyEffects,
    Firmware,
    Platform,
    find_equivalent_platform,
    find_platform,
)

CONTROL_RESERVE = 1.3
"""Thrust over that of hover that a battery must allow at take-off."""
FULL_MARGIN = 0.05
"""V: what a full battery has lost when its drone is ready to take off."""
LARGEST_VOLTAGE = 5.0
"""V: largest voltage that is searched for a thrust."""
MOTOR_LEVEL_WORLDS = (WORLD_URIS.motor_level, WORLD_URIS.mujoco)
"""Worlds with the bodies of [motors]."""


def build_body(drone: DroneTable, has_worn_battery: bool = False) -> Platform:
    """Return the platform of the drone's body, with all effects that were found in its flights.

    has_worn_battery: wears the battery of the platform; what was found of the battery stays as found

    Commands are scaled with the rotors, see `simulation.common.mismatch`: the thrust factor is left to the caller.
    """
    row = find_platform(drone.platform)
    found = drone.calibration
    return replace(
        row,
        drag=row.drag if found.drag is None else found.drag,
        rotor=(
            row.rotor
            if found.rotor_lag is None
            else replace(row.rotor, lag=found.rotor_lag)
        ),
        battery=_build_battery(
            row.battery.worn if has_worn_battery else row.battery, found
        ),
        effects=BodyEffects(
            speed_moment=found.speed_moment,
            motor_factors=found.motor_factors,
            rate_damping=found.rate_damping,
            delay=found.rotor_delay,
        ).filled(row.effects),
    )


def find_thrust_factor(drone: DroneTable) -> float:
    """Return the true thrust of a drone as a share of its platform's."""
    found = drone.calibration.thrust_factor
    return 1.0 if found is None else found


def find_known_platform(drone: DroneTable) -> Platform:
    """Return the platform that the controller of a drone knows.

    It makes the thrusts that its controller commands, see `platforms.find_equivalent_platform`. Two lags in series are
    taken for one of their sum. A weak thrust or battery raises the voltage below which the drone does not take off.

    Raises ConfigError if the drone could not take off with a full battery.
    """
    row = build_body(drone)
    lag = row.rotor.lag + (row.effects.delay or 0.0)
    one_lag = replace(row, rotor=replace(row.rotor, lag=lag))
    known = find_equivalent_platform(one_lag, find_thrust_factor(drone))
    if drone.battery_warning is not None:
        warned = replace(known.battery, begin=drone.battery_warning)
        known = replace(known, battery=warned)
    if drone.calibration == CalibrationTable():
        return known
    battery = known.battery
    begin = max(battery.begin, compute_least_voltage(known))
    if begin > battery.full - FULL_MARGIN:
        raise ConfigError(
            f"drone {drone.id}: calibration",
            f"thrust_factor and battery_resistance that need {begin:.2f} V at take-off",
            f"at most {battery.full - FULL_MARGIN:.2f} V, what a full battery has",
            "Calibrate again, or give the drone another battery.",
        )
    return replace(known, battery=replace(battery, begin=begin))


def find_firmware(drone: DroneTable) -> Firmware:
    """Return the firmware of the drone's platform, with the voltage at which this drone lands."""
    firmware = find_platform(drone.platform).firmware
    if drone.battery_critical is None:
        return firmware
    return replace(firmware, low=drone.battery_critical)


def find_controlled_platform(drone: DroneTable, motors: MotorsTable) -> Platform:
    """Return the platform for which the controllers of a drone are made.

    Where its moment of speed is not known, it is that of a typical drone, if the drone is real or simulated at the
    motor level.

    motors: [motors], with the moment of typical drones
    """
    known = find_known_platform(drone)
    if drone.uri not in MOTOR_LEVEL_WORLDS and not has_radio(drone):
        return known
    moment = motors.imperfections * motors.speed_moment
    x, y, _ = known.inertia
    typical = BodyEffects(speed_moment=(moment * x, moment * y))
    return replace(known, effects=known.effects.filled(typical))


def compute_least_voltage(platform: Platform) -> float:
    """Return the voltage in V at rest from which the drone can take off with CONTROL_RESERVE.

        V + R (P / V + I_idle),   f(V) = CONTROL_RESERVE m g / 4

    P is the power in hover; f the thrust of a motor at full duty cycle.
    """
    volts = np.linspace(0.0, LARGEST_VOLTAGE, 501)
    thrusts = np.polynomial.Polynomial(platform.rotor.voltage)(volts)
    wanted = CONTROL_RESERVE * platform.weight / 4.0
    loaded = float(np.interp(wanted, thrusts, volts))
    cell = platform.battery
    return loaded + cell.resistance * (cell.hover_power / loaded + cell.idle)


def _build_battery(battery: Battery, found: CalibrationTable) -> Battery:
    """Return the battery with the calibrated resistance and capacity."""
    return replace(
        battery,
        resistance=(
            battery.resistance
            if found.battery_resistance is None
            else found.battery_resistance
        ),
        capacity=(
            battery.capacity
            if found.battery_capacity is None
            else found.battery_capacity
        ),
    )
