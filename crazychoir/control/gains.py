"""The gains that ship, and how late a drone obeys. MARGINS says what each row was checked at, and a test holds it."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from crazychoir.platforms import Platform
from crazychoir.types import Vec

Axes = tuple[float, float, float]
HOLD = 0.005  # s, half a tick at 100 Hz: the delay of holding commands
SETTLING = 0.005  # s, that the rate loop on board takes for the slow rates of a flat trajectory: its integral does most


@dataclass(frozen=True)
class Gains:
    """Gains in units of acceleration, independent of the mass.

    kp: 1/s2, kv: 1/s, world x, y, z;  kr: 1/s, body roll, pitch, yaw;  max_tilt: rad.
    lead: of FlatnessAccelerationCtrl, how much of the rate of the desired attitude it feeds forward, behind a low-pass
    of lead_cutoff rad/s.
    rate_delay, thrust_delay: s, how late body rates and thrust follow their commands: what is known of the reference
    is fed forward so much earlier.
    ki_thrust: 1/s2, ki_trim: 1/s3: how fast Trim learns what thrust and attitude are off by; 0: not at all.
    """

    kp: Axes
    kv: Axes
    kr: Axes
    max_tilt: float = 0.8
    lead: float = 0.0
    lead_cutoff: float = 50.0
    rate_delay: float = 0.0
    thrust_delay: float = 0.0
    ki_thrust: float = 0.0
    ki_trim: float = 0.0

    @property
    def position(self) -> Vec:
        """(13,) for the kernels: kp, kv, max_tilt, lead, lead_cutoff, rate_delay, thrust_delay, ki_thrust, ki_trim."""
        return np.array(
            [
                *self.kp,
                *self.kv,
                self.max_tilt,
                self.lead,
                self.lead_cutoff,
                self.rate_delay,
                self.thrust_delay,
                self.ki_thrust,
                self.ki_trim,
            ]
        )

    def on_motors(self, platform: Platform, command_delay: float) -> "Gains":
        """These gains for a drone whose rates are controlled on board; command_delay: s, until it hears a command."""
        late = HOLD + command_delay
        return replace(
            self, rate_delay=late + SETTLING, thrust_delay=late + platform.rotor.lag
        )

    def on_rates(self, rate_lag: float, command_delay: float) -> "Gains":
        """These gains for the lightweight plant: rate_lag: s, of its body rates; its thrust follows at once."""
        late = HOLD + command_delay
        return replace(self, rate_delay=late + rate_lag, thrust_delay=late)


class Tuned(ABC):
    """A strategy whose gains may change while it flies."""

    def __init__(self, gains: Gains) -> None:
        self.gains = gains

    @property
    def gains(self) -> Gains:
        """The gains; new ones act from the next call on."""
        return self._gains

    @gains.setter
    def gains(self, gains: Gains) -> None:
        self._gains, self._figures = gains, self._tuned(gains)

    @abstractmethod
    def _tuned(self, gains: Gains) -> Vec:
        """The figures of the kernel."""


STANDARD = Gains(
    kp=(6.0, 6.0, 10.0),
    kv=(4.0, 4.0, 5.0),
    kr=(8.0, 8.0, 4.0),
    ki_thrust=6.0,
    ki_trim=3.0,
)
# Behind a bearing law: a slow attitude loop and some lead leave the delay margin to the formation's modes. Its position
# gains are as fast as that attitude loop allows.
FORMATION = Gains(kp=(1.0, 1.0, 10.0), kv=(1.5, 1.5, 5.0), kr=(2.0, 2.0, 4.0), lead=0.4)
# The same behind a rate loop on board, which is faster than RATE_LAG: what gyros are off by tilts a drone less.
FORMATION_ON_MOTORS = replace(FORMATION, kr=(3.5, 3.5, 4.0), lead=0.3)
# Behind a law whose modes are all alike, as the normalised one: 8 1/s2, 4.5 1/s are as fast as 40 ms of margin allow.
AGILE = Gains(kp=(8.0, 8.0, 10.0), kv=(4.5, 4.5, 5.0), kr=(7.0, 7.0, 4.0), lead=0.5)
SHIPPED = {
    "standard": STANDARD,
    "formation": FORMATION,
    "formation_on_motors": FORMATION_ON_MOTORS,
    "agile": AGILE,
}
RANGES = {"max_tilt": (0.2, 1.2), "rate_delay": (0.0, 0.2), "thrust_delay": (0.0, 0.2)}
"""What the delay margin does not see, rad and s: below 0.2 rad a drone can hardly brake, from pi/2 on it flees."""
OF_TRACKING = ("kp", "kv", "kr", *RANGES, "ki_thrust", "ki_trim")
"""Gains that FlatnessPositionCtrl and its attitude control obey, which is all that a user may set."""
