"""The real firmware's controllers as laws, if its Python bindings `cffirmware` are installed."""

import importlib
import math
from collections.abc import Callable
from typing import Any

from crazychoir.errors import ConfigError
from crazychoir.simulation.onboard.laws import (
    LAW_PERIOD,
    Answer,
    ForceTorque,
    Legacy,
    Setpoint,
)
from crazychoir.simulation.onboard.units import FULL_THRUST_COMMAND
from crazychoir.types import State, Vec

BOUND_CONTROLLERS = ("Pid", "Mellinger", "Lee")


class FirmwareLaw:
    """A law that calls controller<name> of the bindings.

    Example: `onboard.register("real", FirmwareLaw("Mellinger", thrust_max))`.
    name: Pid, Mellinger or Lee
    thrust_max: N: thrust of a motor at the command 65535
    Raises ConfigError for another name, or if the bindings are missing.
    """

    def __init__(self, name: str, thrust_max: float) -> None:
        if name not in BOUND_CONTROLLERS:
            raise ConfigError(
                "FirmwareLaw: name", name, f"one of {', '.join(BOUND_CONTROLLERS)}"
            )
        self._firmware = _import_bindings()
        self._step = _initialise_controller(self._firmware, name)
        self._per_newton = FULL_THRUST_COMMAND / (4.0 * thrust_max)
        self._control, self._sensors = (
            self._firmware.control_t(),
            self._firmware.sensorData_t(),
        )
        self._setpoint, self._state = (
            self._firmware.setpoint_t(),
            self._firmware.state_t(),
        )
        self._ms = 0

    def __call__(
        self, setpoint: Setpoint, estimate: State, gyro: Vec, dt: float = LAW_PERIOD
    ) -> Answer:
        """Run one pass of the firmware's controller."""
        self._tell_setpoint(setpoint)
        self._tell_state(estimate)
        _write_vector(self._sensors.gyro, [math.degrees(w) for w in gyro])
        self._step(self._control, self._setpoint, self._sensors, self._state, self._ms)
        self._ms += round(1000.0 * dt)
        return self._answer()

    def _tell_setpoint(self, s: Setpoint) -> None:
        sp = self._setpoint
        firmware = self._firmware
        names = (firmware.modeDisable, firmware.modeAbs, firmware.modeVelocity)
        for axis in ("x", "y", "z", "roll", "pitch", "yaw", "quat"):
            setattr(sp.mode, axis, names[getattr(s.modes, axis)])
        sp.velocity_body = s.modes.body_velocity
        for part, values in (
            (sp.position, s.p),
            (sp.velocity, s.v),
            (sp.acceleration, s.a),
            (sp.jerk, s.j),
        ):
            _write_vector(part, values)
        _write_vector(sp.attitudeQuaternion, s.q)
        _write_angles(sp.attitude, s.roll, -s.pitch, s.yaw)
        nose_up = -1.0 if s.modes.pitch == 2 else 1.0
        _write_angles(sp.attitudeRate, s.w[0], nose_up * s.w[1], s.w[2])
        sp.thrust = s.thrust * self._per_newton

    def _tell_state(self, e: State) -> None:
        x, y, z, w = (float(c) for c in e.q)
        _write_vector(self._state.position, e.p)
        _write_vector(self._state.velocity, e.v)
        _write_vector(self._state.attitudeQuaternion, e.q)
        _write_angles(
            self._state.attitude,
            math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            -math.asin(min(max(2.0 * (w * y - x * z), -1.0), 1.0)),
            math.atan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z)),
        )

    def _answer(self) -> Answer:
        c = self._control
        if c.controlMode == self._firmware.controlModeForceTorque:
            return ForceTorque(c.thrustSi, c.torqueX, c.torqueY, c.torqueZ)
        return Legacy(c.thrust, c.roll, c.pitch, c.yaw)


def _import_bindings() -> Any:
    try:
        return importlib.import_module("cffirmware")
    except ModuleNotFoundError as error:
        raise ConfigError(
            "FirmwareLaw: cffirmware",
            "no such module",
            "the Python bindings of crazyflie-firmware",
            "Build them there with `make bindings_python` and put them on the PYTHONPATH, or fly the controllers "
            "pid, mellinger, lee of this package.",
        ) from error


def _initialise_controller(firmware: Any, name: str) -> Callable[..., None]:
    """Initialise the controller and return its function.

    Some bindings keep the memory of a controller in an argument; this drone then has its own
    memory.
    """
    step: Callable[..., None] = getattr(firmware, f"controller{name}")
    memory = getattr(firmware, f"controller{name}_t", None)
    if memory is None:
        getattr(firmware, f"controller{name}Init")()
        return step
    own = memory()
    getattr(firmware, f"controller{name}Init")(own)
    return lambda *arguments: step(own, *arguments)


def _write_vector(part: Any, values: Any) -> None:
    for name, value in zip("xyzw", values, strict=False):
        setattr(part, name, float(value))


def _write_angles(part: Any, roll: float, pitch: float, yaw: float) -> None:
    part.roll = math.degrees(roll)
    part.pitch = math.degrees(pitch)
    part.yaw = math.degrees(yaw)
