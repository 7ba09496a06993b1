"""From newtons to the thrust command of a set-point: by platform and by the firmware's release."""

import re

from crazychoir.errors import ConfigError
from crazychoir.platforms import Firmware
from crazychoir.simulation.onboard.units import thrust_raw

LINEAR_SINCE = (2025, 10)
"""Release from which on the command is linear in newtons, 65535 = thrust_max of each motor (crazyflie-firmware)."""
BEFORE = 42_000 / 0.39
"""Command a newton of releases before: measured for a bare Crazyflie 2.1 by the authors of CrazyChoir."""
OLDEST = (2017, 1)


def command_a_newton(release: str, firmware: Firmware, given: float | None, where: str) -> float:
    """Thrust command a newton, all motors together.

    release: as the firmware says it, "2025.12" or "2025.12.1 +3";  given: that of the swarm file, which counts before
    all. Raises ConfigError for a release that is none, or not known.
    """
    if given is not None:
        return given
    found = re.match(r"(\d{4})\.(\d{1,2})\b", release)
    number = (int(found[1]), int(found[2])) if found else (0, 0)
    if number < OLDEST or not 1 <= number[1] <= 12:
        do = "Set thrust_map in [radio]: command a newton; 136531 for a Crazyflie 2.1 of today. Or send vel or xyz."
        allowed = "a release as 2025.12, by which thrust is known"
        raise ConfigError(f"{where}: firmware", release or "no release", allowed, do)
    return thrust_raw(1.0, firmware) if number >= LINEAR_SINCE else BEFORE
