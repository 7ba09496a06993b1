"""The parameters of a drone's controllers that can be read, and partly changed, in flight."""

from typing import Any

from crazychoir.control.choice import Controls, change_gains
from crazychoir.errors import ConfigError

READ_ONLY_PARAMETERS = (
    "trim.thrust",
    "trim.roll_rad",
    "trim.pitch_rad",
    "platform.name",
    "platform.mass",
)


class ControllerParameters:
    """The parameters of one drone.

    `control.kp`, `control.kr`, ... may be set within their stable range. A drone that gets
    velocities or places has none of these: the gains of its firmware fly it. `trim.thrust`,
    `trim.roll_rad` and `trim.pitch_rad` can be read only: what the drone has learnt of itself.
    """

    def __init__(self, controls: Controls) -> None:
        self.controls = controls

    def all(self) -> dict[str, Any]:
        """Return all parameters by name."""
        controls = self.controls
        pitch, roll = controls.trim.tilt
        return {f"control.{name}": value for name, value in controls.tuned.items()} | {
            "trim.thrust": controls.trim.thrust,
            "trim.roll_rad": -float(roll),
            "trim.pitch_rad": float(pitch),
            "platform.name": controls.platform.name,
            "platform.mass": controls.platform.mass,
        }

    def get(self, name: str) -> Any:
        """Return one parameter; raises ConfigError, which lists all names, for an unknown name."""
        known = self.all()
        if name not in known:
            raise ConfigError(name, "no such parameter", f"one of {', '.join(known)}")
        return known[name]

    def values(self, name: str | None) -> dict[str, Any]:
        """Return one parameter by its name, or all."""
        return self.all() if name is None else {name: self.get(name)}

    def set(self, name: str, value: Any) -> Any:
        """Change one parameter and return its value.

        Raises ConfigError if it is read-only, of another kind, or would not be stable.
        """
        self.get(name)
        if name in READ_ONLY_PARAMETERS:
            raise ConfigError(name, value, "nothing: it can only be read")
        gains = change_gains(
            self.controls.gains, {name.removeprefix("control."): value}, "control"
        )
        self.controls.retune(gains)
        return self.get(name)
