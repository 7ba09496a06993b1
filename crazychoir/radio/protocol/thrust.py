"""Convert newtons to the thrust command of a set-point, by platform and firmware release."""

import re

from crazychoir.errors import ConfigError
from crazychoir.firmware.release import THRUST_RELEASES, parse_release
from crazychoir.platforms import Platform
from crazychoir.simulation.onboard.units import convert_thrust_to_raw


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
    number = parse_release(release)
    linear = convert_thrust_to_raw(1.0, platform.firmware)
    old = platform.firmware.old_thrust_map
    if number is not None:
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
