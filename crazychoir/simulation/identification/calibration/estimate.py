"""Calibrate a drone: identify its parameters in each flight, and combine the flights."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from crazychoir.platforms import Platform
from crazychoir.simulation.identification.calibration.battery import (
    compute_thrusts,
    estimate_capacity,
    estimate_resistance,
)
from crazychoir.simulation.identification.calibration.flight import CalibrationFlight
from crazychoir.simulation.identification.calibration.forces import (
    BodyMotion,
    estimate_sideways,
    estimate_thrust,
    measure_motion,
)
from crazychoir.simulation.identification.calibration.instruments import (
    IdentifiedValues,
)
from crazychoir.simulation.identification.calibration.noise import estimate_noise
from crazychoir.simulation.identification.calibration.rotors import (
    delay_thrusts,
    estimate_lag,
)
from crazychoir.simulation.identification.calibration.torques import (
    estimate_torques,
    find_yaw_imbalance,
    make_motor_factors,
)
from crazychoir.types import Vec


class EvidenceSource(StrEnum):
    """What parameters are identified from."""

    FORCES = "forces"
    """Second derivatives of the places, against motors and speed."""
    ACCELEROMETER = "accelerometer"
    """Its z axis, against the motors."""
    TURNS = "turns"
    """Rates that set-points cause, against motors and speed."""
    DUTY = "mean duty"
    """Mean duty cycles of the motors."""
    VIBRATION = "vibration"
    """What a smooth motion does not explain."""
    VOLTAGE = "voltage"
    """Voltage of the battery, against the power of the motors."""


class ParameterRule(NamedTuple):
    """One quantity that flights identify."""

    unit: str
    """Its unit."""
    source: EvidenceSource
    """What it is identified from."""
    largest_error: Callable[[Platform], float]
    """Returns the largest standard error with which it counts as identified."""
    default: Callable[[Platform], float]
    """Returns its value without a calibration."""
    least: float = -math.inf
    """Smallest value that is possible."""
    floor: float = 0.0
    """Standard error that no flight undercuts, because the model is not exact."""


def _rule(
    unit: str,
    source: EvidenceSource,
    error: float | Callable[[Platform], float],
    default: float | Callable[[Platform], float],
    least: float = -math.inf,
    floor: float = 0.0,
) -> ParameterRule:
    return ParameterRule(
        unit,
        source,
        error if callable(error) else _constant(error),
        default if callable(default) else _constant(default),
        least,
        floor,
    )


def _constant(value: float) -> Callable[[Platform], float]:
    def give(platform: Platform) -> float:
        del platform
        return value

    return give


def _drag(axis: int) -> Callable[[Platform], float]:
    def give(platform: Platform) -> float:
        return platform.drag[axis]

    return give


def _share_of_mass(share: float) -> Callable[[Platform], float]:
    def give(platform: Platform) -> float:
        return share * platform.mass

    return give


def _share_of_inertia(share: float) -> Callable[[Platform], float]:
    def give(platform: Platform) -> float:
        return share * platform.inertia[0]

    return give


def _lag(platform: Platform) -> float:
    return platform.rotor.lag


def _resistance(platform: Platform) -> float:
    return platform.battery.resistance


def _capacity(platform: Platform) -> float:
    return platform.battery.capacity


PARAMETER_RULES = {
    "thrust_factor": _rule(
        "", EvidenceSource.FORCES, 0.01, 1.0, least=0.1, floor=0.001
    ),
    "trim_roll": _rule("rad", EvidenceSource.FORCES, 0.003, 0.0),
    "trim_pitch": _rule("rad", EvidenceSource.FORCES, 0.003, 0.0),
    "drag_x": _rule(
        "kg/s", EvidenceSource.FORCES, _share_of_mass(0.04), _drag(0), least=0.0
    ),
    "drag_y": _rule(
        "kg/s", EvidenceSource.FORCES, _share_of_mass(0.04), _drag(1), least=0.0
    ),
    "drag_z": _rule(
        "kg/s", EvidenceSource.FORCES, _share_of_mass(0.02), _drag(2), least=0.0
    ),
    "rotor_lag": _rule(
        "s", EvidenceSource.ACCELEROMETER, 0.008, _lag, 0.0, floor=0.001
    ),
    "rotor_delay": _rule(
        "s", EvidenceSource.ACCELEROMETER, 0.008, 0.0, 0.0, floor=0.001
    ),
    "moment_roll": _rule(
        "N m per m/s", EvidenceSource.TURNS, _share_of_inertia(4.0), 0.0
    ),
    "moment_pitch": _rule(
        "N m per m/s", EvidenceSource.TURNS, _share_of_inertia(4.0), 0.0
    ),
    "imbalance_roll": _rule("N m", EvidenceSource.TURNS, _share_of_inertia(2.0), 0.0),
    "imbalance_pitch": _rule("N m", EvidenceSource.TURNS, _share_of_inertia(2.0), 0.0),
    "damping_roll": _rule("1/s", EvidenceSource.TURNS, 1.5, 0.0, least=0.0),
    "damping_pitch": _rule("1/s", EvidenceSource.TURNS, 1.5, 0.0, least=0.0),
    "imbalance_yaw": _rule("", EvidenceSource.DUTY, 0.01, 0.0, floor=0.002),
    "noise_position": _rule("m", EvidenceSource.VIBRATION, 0.001, 0.0),
    "noise_angle": _rule("rad", EvidenceSource.VIBRATION, 0.005, 0.0),
    "noise_gyro": _rule("rad/s", EvidenceSource.VIBRATION, 0.02, 0.0),
    "battery_resistance": _rule(
        "ohm", EvidenceSource.VOLTAGE, 0.04, _resistance, least=0.001, floor=0.005
    ),
    "battery_capacity": _rule(
        "A s", EvidenceSource.VOLTAGE, 100.0, _capacity, least=1.0, floor=20.0
    ),
}
"""The quantities in the order of the table, with what makes them identified."""
ERROR_FACTOR = 1.4
"""True errors over the standard errors of one flight: what 20 simulated drones had."""
MOTOR_GAIN = "motor_gain"
"""Name of the gain of the motors' torques: shown, but no part of a calibration."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """One calibrated quantity."""

    name: str
    """Key of PARAMETER_RULES."""
    value: float
    """What the calibration uses: identified, or the default."""
    deviation: float
    """Standard error of what was found; infinite if nothing was."""
    found: float
    """What was found, even if it is not used; nan if nothing was."""
    default: float
    """Value without a calibration."""
    is_identified: bool
    """Whether the flights excite it enough."""
    flights: int
    """Flights that show it."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """The calibration of one drone."""

    platform: Platform
    """The platform on which it is based."""
    estimates: dict[str, Estimate]
    """All quantities, in the order of PARAMETER_RULES."""
    gain: float
    """Angular acceleration for the same thrusts as a share of the platform's; biased, see `torques`."""

    def value(self, name: str) -> float:
        """Return the value that the calibration uses for a quantity."""
        return self.estimates[name].value

    @property
    def table(self) -> dict[str, Any]:
        """The keys of [drones.calibration]: only what was identified."""
        shown = {
            name: estimate
            for name, estimate in self.estimates.items()
            if estimate.is_identified
        }
        jx, jy, jz = self.platform.inertia
        rows: dict[str, tuple[tuple[str, ...], Callable[[], Any]]] = {
            "thrust_factor": (("thrust_factor",), self._scalar("thrust_factor")),
            "motor_factors": (
                ("imbalance_roll", "imbalance_pitch"),
                self._motor_factors,
            ),
            "trim": (("trim_roll", "trim_pitch"), self._vector("trim", "roll pitch")),
            "rotor_lag": (("rotor_lag", "rotor_delay"), self._scalar("rotor_lag")),
            "rotor_delay": (("rotor_lag", "rotor_delay"), self._scalar("rotor_delay")),
            "drag": (("drag_x", "drag_y"), self._vector("drag", "x y z")),
            "speed_moment": (
                ("moment_roll", "moment_pitch"),
                self._vector("moment", "roll pitch"),
            ),
            "rate_damping": (
                ("damping_roll", "damping_pitch"),
                lambda: [
                    self.value("damping_roll") * jx,
                    self.value("damping_pitch") * jy,
                    0.0 * jz,
                ],
            ),
            "noise": (
                ("noise_position", "noise_angle", "noise_gyro"),
                self._vector("noise", "position angle gyro"),
            ),
            "battery_resistance": (
                ("battery_resistance",),
                self._scalar("battery_resistance"),
            ),
            "battery_capacity": (
                ("battery_capacity",),
                self._scalar("battery_capacity"),
            ),
        }
        return {
            key: _round(give())
            for key, (needed, give) in rows.items()
            if all(name in shown for name in needed)
        }

    def _scalar(self, name: str) -> Callable[[], float]:
        return lambda: self.value(name)

    def _vector(self, stem: str, parts: str) -> Callable[[], list[float]]:
        return lambda: [self.value(f"{stem}_{part}") for part in parts.split()]

    def _motor_factors(self) -> list[float]:
        factors: list[float] = make_motor_factors(
            self.value("imbalance_roll"),
            self.value("imbalance_pitch"),
            self.value("imbalance_yaw"),
            self.platform.weight,
            self.platform.arm,
        ).tolist()
        return factors


def _round(value: Any) -> Any:
    """Return numbers with five significant digits."""
    if isinstance(value, list):
        return [_round(part) for part in value]
    return float(f"{value:.5g}")


def calibrate(flights: Sequence[CalibrationFlight], platform: Platform) -> Calibration:
    """Identify the parameters of the drone that flew these flights.

    Each flight is identified alone; the flights are averaged with the weights of their standard errors, which grow
    where flights differ by more than they allow.
    """
    found = [_identify(flight, platform) for flight in flights]
    estimates = {}
    for name, rule in PARAMETER_RULES.items():
        default = rule.default(platform)
        value, deviation, count = _combine(
            [flight[name] for flight in found], rule.floor
        )
        is_identified = deviation <= rule.largest_error(platform)
        estimates[name] = Estimate(
            name=name,
            value=max(value, rule.least) if is_identified else default,
            deviation=deviation,
            found=value,
            default=default,
            is_identified=is_identified,
            flights=count,
        )
    gain = float(np.mean([flight[MOTOR_GAIN][0] for flight in found]))
    return Calibration(platform, estimates, gain)


def _combine(
    solutions: Sequence[tuple[float, float]], floor: float
) -> tuple[float, float, int]:
    """Return the mean of values with standard errors, its standard error, and the number of values that count."""
    known = [
        (value, ERROR_FACTOR * deviation)
        for value, deviation in solutions
        if math.isfinite(value) and math.isfinite(deviation)
    ]
    if not known:
        return math.nan, math.inf, 0
    values = np.array([value for value, _ in known])
    deviations = np.array([max(deviation, 1e-12) for _, deviation in known])
    weights = deviations**-2
    mean = float(weights @ values / weights.sum())
    scatter = float((weights * (values - mean) ** 2).sum() / max(len(values) - 1, 1))
    deviation = math.sqrt(max(scatter, 1.0) / float(weights.sum()))
    return mean, math.hypot(deviation, floor), len(known)


def _identify(
    flight: CalibrationFlight, platform: Platform
) -> dict[str, tuple[float, float]]:
    """Return value and standard error of each quantity in one flight."""
    m = platform.mass
    resistance = estimate_resistance(flight, platform)
    ohms = float(np.clip(resistance.values[0], 0.0, 1.0))
    sideways = estimate_sideways(flight)
    motion = measure_motion(flight, sideways.values[:2])
    lags, used = _identify_lags(flight, motion, platform, ohms)
    settled = compute_thrusts(flight, platform, ohms, float(used.sum()))
    thrusts = delay_thrusts(settled, float(used[0]), float(used[1]))
    lift = estimate_thrust(flight, motion, thrusts.sum(axis=1) / m)
    factor = float(lift.values[0])
    torques = estimate_torques(flight, motion, thrusts, factor, platform)
    yaw = find_yaw_imbalance(flight, thrusts, platform)
    noise = estimate_noise(flight)
    capacity = estimate_capacity(flight, platform, ohms)
    names_and_solutions: list[tuple[tuple[str, ...], Vec, Vec]] = [
        (("thrust_factor",), lift.values[:1], lift.deviations[:1]),
        (("trim_roll", "trim_pitch"), sideways.values[:2], sideways.deviations[:2]),
        (
            ("drag_x", "drag_y"),
            m * sideways.values[2:],
            m * sideways.deviations[2:],
        ),
        (("drag_z",), m * lift.values[1:], m * lift.deviations[1:]),
        (("rotor_lag", "rotor_delay"), lags.values, lags.deviations),
        (
            ("moment_roll", "imbalance_roll", "damping_roll"),
            torques.values[:3],
            torques.deviations[:3],
        ),
        (
            ("moment_pitch", "imbalance_pitch", "damping_pitch"),
            torques.values[4:7],
            torques.deviations[4:7],
        ),
        ((MOTOR_GAIN,), np.array([torques.values[[3, 7]].mean()]), np.zeros(1)),
        (("imbalance_yaw",), np.array([yaw]), np.zeros(1)),
        (
            ("noise_position", "noise_angle", "noise_gyro"),
            noise.values,
            noise.deviations,
        ),
        (("battery_resistance",), resistance.values, resistance.deviations),
        (("battery_capacity",), capacity.values, capacity.deviations),
    ]
    return {
        name: (float(value), float(deviation))
        for names, values, deviations in names_and_solutions
        for name, value, deviation in zip(names, values, deviations, strict=True)
    }


def _identify_lags(
    flight: CalibrationFlight, motion: BodyMotion, platform: Platform, ohms: float
) -> tuple[IdentifiedValues, Vec]:
    """Return lag and delay (2,) in s, as found and as to use: those of the platform if the flight hardly shows them.

    The voltage sags behind the rotors, so the lag is found twice.
    """
    used = np.array([platform.rotor.lag, 0.0])
    found = IdentifiedValues(np.full(2, math.nan), np.full((2, 2), math.inf))
    if flight.acc is None:
        return found, used
    limit = PARAMETER_RULES["rotor_lag"].largest_error(platform) / ERROR_FACTOR
    for _ in range(2):
        settled = compute_thrusts(flight, platform, ohms, float(used.sum()))
        thrust = settled.sum(axis=1) / platform.mass
        found = estimate_lag(flight, thrust, motion.velocity[:, 2])
        if not found.deviations[0] < limit:
            break
        used = found.values
    return found, used
