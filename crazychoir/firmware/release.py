"""The releases of the firmware that this package, and the modules that use it, describe."""

import re
from dataclasses import dataclass

DESCRIBED_RELEASE = "2025.12"
"""Release of crazyflie-firmware for which the codes, bits and times of this package hold.

They were compared with a build of its main branch of 2026, which has the same protocol version.
"""
PROTOCOL_VERSION = 12
"""Version of the CRTP protocol of this release."""


@dataclass(frozen=True, slots=True)
class ThrustReleases:
    """Firmware releases, as (year, month), that decide the form of the thrust command."""

    linear_since: tuple[int, int] = (2025, 10)
    """First release with a thrust command linear in newtons. 65535 is thrust_max of each motor
    (crazyflie-firmware).
    """
    measured_until: tuple[int, int] = (2025, 2)
    """Last release for which a platform's `old_thrust_map` is right.

    In 2025 thrust became linear on one platform after another: a release between may have either form.
    So may a development build, which can be much newer than its tag.
    """
    oldest: tuple[int, int] = (2017, 1)
    """First release with a number of this form."""


THRUST_RELEASES = ThrustReleases()


def parse_release(text: str) -> tuple[int, int] | None:
    """Return the year and month of a release; None if the text has none.

    text: "2025.12" or, for a build some commits later, "2025.12.1 +3"
    """
    found = re.match(r"(\d{4})\.(\d{1,2})\b", text)
    if found is None:
        return None
    number = (int(found[1]), int(found[2]))
    is_month = 1 <= number[1] <= 12
    return number if is_month and number >= THRUST_RELEASES.oldest else None
