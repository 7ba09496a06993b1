"""The gains that ship. tests/equations/test_margin.py holds every row to 40 ms of delay margin behind 86 ms of lag."""

from dataclasses import dataclass

import numpy as np

from crazychoir.math3d import Vec

Axes = tuple[float, float, float]


@dataclass(frozen=True)
class Gains:
    """Gains in units of acceleration, independent of the mass.

    kp: 1/s2, kv: 1/s, world x, y, z;  kr: 1/s, body roll, pitch, yaw;  max_tilt: rad.
    lead: of FlatnessAccelerationCtrl, how much of the rate of the desired attitude it feeds forward, behind a low-pass
    of lead_cutoff rad/s.
    """

    kp: Axes
    kv: Axes
    kr: Axes
    max_tilt: float = 0.8
    lead: float = 0.0
    lead_cutoff: float = 50.0

    @property
    def position(self) -> Vec:
        """(9,) for the kernels: kp, kv, max_tilt, lead, lead_cutoff."""
        return np.array([*self.kp, *self.kv, self.max_tilt, self.lead, self.lead_cutoff])


STANDARD = Gains(kp=(6.0, 6.0, 10.0), kv=(4.0, 4.0, 5.0), kr=(8.0, 8.0, 4.0))
# Behind a bearing law: a slow attitude loop and some lead leave the delay margin to the formation's modes. Its position
# gains are as fast as that attitude loop allows.
FORMATION = Gains(kp=(1.0, 1.0, 10.0), kv=(1.5, 1.5, 5.0), kr=(2.0, 2.0, 4.0), lead=0.4)
SHIPPED = {"standard": STANDARD, "formation": FORMATION}
