"""The radio:// addresses of a swarm file: find their dongles, and change their channels."""

import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crazychoir.config.reader import parse
from crazychoir.errors import ConfigError
from crazychoir.files import text_files
from crazychoir.radio.protocol.channels import LAST

RADIO = re.compile(r"(radio://([^/]+)/)(\d{1,3})((?:[/?].*)?)")
"""Pattern of a radio uri.

Groups: all before the channel, the dongle within it, the channel, the rest.
"""
_TOKENS = re.compile(
    r'"""(?:\\.|[^\\])*?"""'
    r"|'''.*?'''"
    r'|"(?:\\.|[^"\\\n])*"'
    r"|'[^'\n]*'"
    r"|#[^\n]*",
    re.DOTALL,
)
"""Pattern of texts and comments in TOML, and of texts in JSON."""
_KEY = re.compile(r"""(?:^|[\s,{.])(?:uri|"uri"|'uri')\s*[=:]\s*$""")
"""Pattern of the characters before a text that is the value of a key `uri`."""
SERIAL = 10
"""Digits of a dongle's serial number."""
SHOWN = 60
"""Characters before a text that are searched for its key."""


def dongles(text: str, where: str) -> dict[str, list[str]]:
    """Return the radio:// uris of each dongle, {dongle: uris}, in the order of the file.

    where: name of the file for errors
    Raises ConfigError if the file has no radio uri, or one without a channel.
    """
    found: dict[str, list[str]] = {}
    for uri in (drone["uri"] for drone in _on_radio(_values(text, where))):
        match = RADIO.fullmatch(uri)
        if match is None:
            allowed = (
                "radio://DONGLE/CHANNEL/RATE/ADDRESS, as radio://0/80/2M/E7E7E7E701"
            )
            raise ConfigError(
                f"{where}: uri",
                uri,
                allowed,
                "Write its channel, so that there is one to change.",
            )
        found.setdefault(_dongle(match), []).append(uri)
    if not found:
        do = "Drones of other worlds need no channel."
        raise ConfigError(
            f"{where}: drones",
            "no uri with radio://",
            "at least one drone on a radio",
            do,
        )
    return found


def with_channels(text: str, channels: Mapping[str, int], where: str) -> str:
    """Return the text with new channels in the drones' uris; nothing else changes.

    channels: channel of each dongle
    where: name of the file for errors
    Raises ConfigError if a uri is written in a way that is not found in the text.
    """
    expected = _values(text, where)
    for drone in _on_radio(expected):
        drone["uri"] = _on_channel(drone["uri"], channels)
    changed = _TOKENS.sub(lambda token: _token(token, channels), text)
    if _values(changed, where) != expected:
        wanted = ", ".join(
            f"{channel} for dongle {dongle}" for dongle, channel in channels.items()
        )
        do = f"Write the channels yourself: {wanted}."
        raise ConfigError(
            f"{where}: uri",
            "another way of writing",
            'plain texts, as uri = "radio://0/80/2M"',
            do,
        )
    return changed


def require_writable(path: Path) -> None:
    """Raise ConfigError if the channels in the file could not be changed.

    Call it before anything is measured.
    """
    path = path.resolve()
    text = read_text(path)
    with_channels(text, dict.fromkeys(dongles(text, str(path)), LAST), str(path))
    if not (os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)):
        raise ConfigError(
            str(path),
            "Permission denied",
            "a file that can be written, in a folder that can",
        )


def write_channels(path: Path, channels: Mapping[str, int]) -> None:
    """Change the channels in a swarm file: all of them or, if that fails, none."""
    path = path.resolve()
    text = read_text(path)
    beside = path.with_name(f"{path.name}.new")
    try:
        beside.write_bytes(with_channels(text, channels, str(path)).encode())
        shutil.copymode(path, beside)
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise ConfigError(
            str(path),
            str(error.strerror),
            "a file that can be written, in a folder that can",
        ) from error


def read_text(path: Path) -> str:
    """Return the exact text of a swarm file. Raises ConfigError if it cannot be read."""
    return text_files.read_text(path, "a swarm file, TOML or JSON", exact=True)


def _values(text: str, where: str) -> dict[str, Any]:
    return parse(text.removeprefix("\ufeff"), where)


def _on_radio(raw: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the [[drones]] tables with a radio uri."""
    drones = raw.get("drones")
    tables = (
        [one for one in drones if isinstance(one, dict)]
        if isinstance(drones, list)
        else []
    )
    return [drone for drone in tables if str(drone.get("uri")).startswith("radio://")]


def _on_channel(uri: str, channels: Mapping[str, int]) -> str:
    match = RADIO.fullmatch(uri)
    if match is None or _dongle(match) not in channels:
        return uri
    return f"{match[1]}{channels[_dongle(match)]}{match[4]}"


def _dongle(match: re.Match[str]) -> str:
    """Return the dongle of a uri: its number in plain digits, or its serial number."""
    name = match[2]
    return str(int(name)) if name.isdecimal() and len(name) < SERIAL else name.upper()


def _token(token: re.Match[str], channels: Mapping[str, int]) -> str:
    """Return a text or comment, with another channel if it is the value of a key `uri`."""
    written = token[0]
    before = token.string[max(token.start() - SHOWN, 0) : token.start()]
    return (
        written[0] + _on_channel(written[1:-1], channels) + written[-1]
        if _KEY.search(before)
        else written
    )
