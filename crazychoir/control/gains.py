"""The gains that ship, and the delays of a drone.

STANDARD_GAIN_MARGINS states the delay margin at which each row was checked; a test verifies it.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from crazychoir.numerics.kernels import Records
from crazychoir.platforms import Platform
from crazychoir.types import Vec

Axes = tuple[float, float, float]
HOLD_DELAY = 0.005  # s, half a tick at 100 Hz: the delay of holding commands
RATE_LOOP_DELAY = 0.005
"""Time in s that the rate loop on board takes for the slow rates of a flat trajectory.

Most of it comes from the integral of that loop.
"""


@dataclass(frozen=True)
class Gains:
    """Gains in units of acceleration, independent of the mass."""

    kp: Axes
    """1/s2, world x, y, z."""
    kv: Axes
    """1/s, world x, y, z."""
    kr: Axes
    """1/s, body roll, pitch, yaw."""
    max_tilt: float = 0.8
    """rad."""
    lead: float = 0.0
    """Share of the rate of the desired attitude that FlatnessAccelerationCtrl feeds forward."""
    lead_cutoff: float = 50.0
    """rad/s, of the low-pass behind that feed-forward."""
    rate_delay: float = 0.0
    """s, how late body rates follow their commands.

    The feed-forward of the reference is sent earlier by this time.
    """
    thrust_delay: float = 0.0
    """s, how late the thrust follows its command.

    The feed-forward of the reference is sent earlier by this time.
    """
    ki_thrust: float = 0.0
    """1/s2, how fast Trim learns the error of the thrust; 0 for not at all."""
    ki_trim: float = 0.0
    """1/s3, how fast Trim learns the error of the attitude; 0 for not at all."""

    @property
    def position(self) -> Vec:
        """(13,) for the kernels: kp, kv, max_tilt, and the gains after it.

        lead, lead_cutoff, rate_delay, thrust_delay, ki_thrust, ki_trim
        """
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
        """Return these gains for a drone with a rate control on board.

        platform: of the drone
        command_delay: s, until the drone receives a command
        """
        late = HOLD_DELAY + command_delay
        return replace(
            self,
            rate_delay=late + RATE_LOOP_DELAY,
            thrust_delay=late + platform.rotor.lag,
        )

    def on_rates(self, rate_lag: float, command_delay: float) -> "Gains":
        """Return these gains for the lightweight plant.

        rate_lag: s, of its body rates; its thrust follows at once
        command_delay: s, until the plant receives a command
        """
        late = HOLD_DELAY + command_delay
        return replace(self, rate_delay=late + rate_lag, thrust_delay=late)


class TunedStrategy(ABC):
    """A strategy with gains that may change in flight.

    gains: the first gains
    rows: (1,) of records with the field "figures", where the kernels read the gains
    """

    def __init__(self, gains: Gains, rows: Records) -> None:
        self.rows = rows
        """(1,) of records: figures and memory of the kernels."""
        self.gains = gains

    @property
    def gains(self) -> Gains:
        """The gains; new ones act from the next call on."""
        return self._gains

    @gains.setter
    def gains(self, gains: Gains) -> None:
        self._gains = gains
        figures = self._tuned(gains)
        self.rows["figures"][0, : figures.size] = figures

    @abstractmethod
    def _tuned(self, gains: Gains) -> Vec:
        """Return the figures of the kernels."""


STANDARD_GAINS = Gains(
    kp=(6.0, 6.0, 10.0),
    kv=(4.0, 4.0, 5.0),
    kr=(8.0, 8.0, 4.0),
    ki_thrust=6.0,
    ki_trim=3.0,
)
"""Gains for tracking."""
# Behind a bearing law: a slow attitude loop and some lead leave the delay margin to the formation's
# modes. The position gains are as fast as this attitude loop allows.
FORMATION_GAINS = Gains(
    kp=(1.0, 1.0, 10.0), kv=(1.5, 1.5, 5.0), kr=(2.0, 2.0, 4.0), lead=0.4
)
# As FORMATION_GAINS, behind a rate loop on board, faster than RATE_LAG: gyro errors cause less tilt.
FORMATION_GAINS_ON_MOTORS = replace(FORMATION_GAINS, kr=(3.5, 3.5, 4.0), lead=0.3)
# Behind a law with equal modes, such as the normalised law. 8 1/s2 and 4.5 1/s are as fast as a
# margin of 40 ms allows.
AGILE_GAINS = Gains(
    kp=(8.0, 8.0, 10.0), kv=(4.5, 4.5, 5.0), kr=(7.0, 7.0, 4.0), lead=0.5
)
SHIPPED_GAINS = {
    "standard": STANDARD_GAINS,
    "formation": FORMATION_GAINS,
    "formation_on_motors": FORMATION_GAINS_ON_MOTORS,
    "agile": AGILE_GAINS,
}
"""All gains that ship, by name."""
GAIN_RANGES = {
    "max_tilt": (0.2, 1.2),
    "rate_delay": (0.0, 0.2),
    "thrust_delay": (0.0, 0.2),
}
"""Allowed ranges in rad and s of gains that the delay margin does not cover.

Below 0.2 rad a drone can hardly brake; from pi/2 on it runs away.
"""
TRACKING_GAIN_NAMES = ("kp", "kv", "kr", *GAIN_RANGES, "ki_thrust", "ki_trim")
"""Gains that FlatnessPositionCtrl and its attitude control use: all that a user may set."""
