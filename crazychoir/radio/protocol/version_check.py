"""Whether a drone's firmware is new enough to know what it is going to be sent."""

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform
from crazychoir.radio.protocol.crtp import SINCE
from crazychoir.radio.protocol.handlers import HANDLERS


def check_protocol(version: int, kind: str, platform: Platform, where: str) -> None:
    """ConfigError, with the numbers, if firmware that speaks this version does not know what is sent to its drone.

    version: of its protocol, negative if it does not say it;  kind: of commands, as a swarm file names it.
    """
    missing = _missing(version, kind, platform)
    if not missing:
        return
    form = max(missing, key=SINCE.__getitem__)
    others = ", ".join(
        other for other in HANDLERS if not _missing(version, other, platform)
    )
    found = f"version {version}" if version >= 0 else "no version"
    allowed = f"{SINCE[form]} or newer, for {form} (sender {kind} on {platform.name})"
    do = "Write newer firmware" + (
        f", or choose another sender in [control]: {others}." if others else "."
    )
    raise ConfigError(f"{where}: protocol of its firmware", found, allowed, do)


def _missing(version: int, kind: str, platform: Platform) -> list[str]:
    """The forms that are needed and not known."""
    forms = [HANDLERS[kind].form] + ["arm"] * platform.firmware.needs_arming
    return [form for form in forms if form in SINCE and version < SINCE[form]]
