"""Convert newtons to the thrust command of a set-point, by platform and firmware release."""

import re
from dataclasses import dataclass

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform
from crazychoir.simulation.onboard.units import convert_thrust_to_raw


@dataclass(frozen=True, slots=True)
class ThrustReleases:
    """Firmware releases, as (year, month), that decide the form of the thrust command."""

    linear_since: tuple[int, ...] = (2025, 10)
    """First release with a thrust command linear in newtons. 65535 is thrust_max of each motor
    (crazyflie-firmware).
    """
    measured_until: tuple[int, ...] = (2025, 2)
    """Last release for which a platform's `old_thrust_map` is right.

    In 2025 thrust became linear on one platform after another: a release between may have either form.
    So may a development build, which can be much newer than its tag.
    """
    oldest: tuple[int, ...] = (2017, 1)
    """First release with a number of this form."""


THRUST_RELEASES = ThrustReleases()


def thrust_command_per_newton(
    release: str, platform: Platform, given: float | None, where: str
) -> float:
    """Return the thrust command a newton, all motors together.

    release: text from the firmware: "2025.12" or, for a build some commits later, "2025.12.1 +3"
    given: value of the swarm file, which overrides all others
    where: name of the drone for errors
    Raises ConfigError if the release is unknown, or its thrust on this platform is unknown.
    """
    if given is not None:
        return given
    found = re.match(r"(\d{4})\.(\d{1,2})\b", release)
    number = (int(found[1]), int(found[2])) if found else (0, 0)
    linear = convert_thrust_to_raw(1.0, platform.firmware)
    old = platform.firmware.old_thrust_map
    if number >= THRUST_RELEASES.oldest and 1 <= number[1] <= 12:
        if number >= THRUST_RELEASES.linear_since:
            return linear
        if (
            number <= THRUST_RELEASES.measured_until
            and re.fullmatch(r"[\d.]+", release)
            and old is not None
        ):
            return old
    since = _release_text(THRUST_RELEASES.linear_since)
    until = _release_text(THRUST_RELEASES.measured_until)
    releases = (
        f"{since} or newer"
        if old is None
        else f"{since} or newer, or a release until {until}"
    )
    allowed = f"{releases}, for which the thrust of {platform.name} is known"
    do = "Write newer firmware, or send vel or xyz, or set thrust_map in [radio], the command a newton as you measure "
    do += (
        f"it, of all drones of the file; of this one it is {linear:.0f} since {since}."
    )
    raise ConfigError(f"{where}: firmware", release or "no release", allowed, do)


def _release_text(number: tuple[int, ...]) -> str:
    """Return a release number in the firmware's notation."""
    return f"{number[0]}.{number[1]:02d}"
