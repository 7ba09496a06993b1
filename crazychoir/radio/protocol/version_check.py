"""Check that a drone's firmware is new enough for the packets that it will receive."""

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform
from crazychoir.radio.protocol.crtp import FIRST_VERSIONS
from crazychoir.radio.protocol.handlers import RADIO_HANDLERS


def check_protocol(version: int, kind: str, platform: Platform, where: str) -> None:
    """Raise ConfigError, with the numbers, if the firmware does not know the packets for its drone.

    version: protocol version of the firmware; negative if it does not tell one
    kind: kind of command, as a swarm file names it
    where: name of the drone for errors
    """
    missing = _missing_forms(version, kind, platform)
    if not missing:
        return
    form = max(missing, key=FIRST_VERSIONS.__getitem__)
    others = ", ".join(
        other
        for other in RADIO_HANDLERS
        if not _missing_forms(version, other, platform)
    )
    found = f"version {version}" if version >= 0 else "no version"
    allowed = f"{FIRST_VERSIONS[form]} or newer, for {form} (sender {kind} on {platform.name})"
    do = "Write newer firmware" + (
        f", or choose another sender in [control]: {others}." if others else "."
    )
    raise ConfigError(f"{where}: protocol of its firmware", found, allowed, do)


def _missing_forms(version: int, kind: str, platform: Platform) -> list[str]:
    """Return the forms that are needed but unknown to the firmware."""
    forms = [RADIO_HANDLERS[kind].form] + ["arm"] * platform.firmware.needs_arming
    return [
        form
        for form in forms
        if form in FIRST_VERSIONS and version < FIRST_VERSIONS[form]
    ]
