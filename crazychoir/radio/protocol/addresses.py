"""The radio:// addresses of a swarm file: find their dongles, and change their channels."""

import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crazychoir.config.reader import parse
from crazychoir.errors import ConfigError
from crazychoir.files import text_files
from crazychoir.radio.protocol.channels import RADIO_BAND


@dataclass(frozen=True, slots=True)
class UriSearch:
    """How radio uris are found in the text of a swarm file."""

    radio_uri: re.Pattern[str] = re.compile(r"(radio://([^/]+)/)(\d{1,3})((?:[/?].*)?)")
    """Pattern of a radio uri. Groups: all before the channel, the dongle within it, the channel,
    the rest.
    """
    token: re.Pattern[str] = re.compile(
        r'"""(?:\\.|[^\\])*?"""'
        r"|'''.*?'''"
        r'|"(?:\\.|[^"\\\n])*"'
        r"|'[^'\n]*'"
        r"|#[^\n]*",
        re.DOTALL,
    )
    """Pattern of texts and comments in TOML, and of texts in JSON."""
    uri_key: re.Pattern[str] = re.compile(
        r"""(?:^|[\s,{.])(?:uri|"uri"|'uri')\s*[=:]\s*$"""
    )
    """Pattern of the characters before a text that is the value of a key `uri`."""
    serial_digits: int = 10
    """Digits of a dongle's serial number."""
    key_distance: int = 60
    """Characters before a text that are searched for its key."""


URI_SEARCH = UriSearch()


def find_dongle_uris(text: str, where: str) -> dict[str, list[str]]:
    """Return the radio:// uris of each dongle, {dongle: uris}, in the order of the file.

    where: name of the file for errors
    Raises ConfigError if the file has no radio uri, or one without a channel.
    """
    found: dict[str, list[str]] = {}
    for uri in (drone["uri"] for drone in _radio_tables(_parse_values(text, where))):
        match = URI_SEARCH.radio_uri.fullmatch(uri)
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
        found.setdefault(_dongle_name(match), []).append(uri)
    if not found:
        do = "Drones of other worlds need no channel."
        raise ConfigError(
            f"{where}: drones",
            "no uri with radio://",
            "at least one drone on a radio",
            do,
        )
    return found


def replace_channels(text: str, channels: Mapping[str, int], where: str) -> str:
    """Return the text with new channels in the drones' uris; nothing else changes.

    channels: channel of each dongle
    where: name of the file for errors
    Raises ConfigError if a uri is written in a way that is not found in the text.
    """
    expected = _parse_values(text, where)
    for drone in _radio_tables(expected):
        drone["uri"] = _replace_channel(drone["uri"], channels)
    changed = URI_SEARCH.token.sub(
        lambda token: _replace_in_token(token, channels), text
    )
    if _parse_values(changed, where) != expected:
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
    text = read_swarm_text(path)
    replace_channels(
        text,
        dict.fromkeys(find_dongle_uris(text, str(path)), RADIO_BAND.highest_channel),
        str(path),
    )
    if not (os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)):
        raise ConfigError(
            str(path),
            "Permission denied",
            "a file that can be written, in a folder that can",
        )


def write_channels(path: Path, channels: Mapping[str, int]) -> None:
    """Change the channels in a swarm file: all of them or, if that fails, none."""
    path = path.resolve()
    text = read_swarm_text(path)
    beside = path.with_name(f"{path.name}.new")
    try:
        beside.write_bytes(replace_channels(text, channels, str(path)).encode())
        shutil.copymode(path, beside)
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise ConfigError(
            str(path),
            str(error.strerror),
            "a file that can be written, in a folder that can",
        ) from error


def read_swarm_text(path: Path) -> str:
    """Return the exact text of a swarm file. Raises ConfigError if it cannot be read."""
    return text_files.read_text(path, "a swarm file, TOML or JSON", exact=True)


def _parse_values(text: str, where: str) -> dict[str, Any]:
    return parse(text.removeprefix("\ufeff"), where)


def _radio_tables(raw: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the [[drones]] tables with a radio uri."""
    drones = raw.get("drones")
    tables = (
        [one for one in drones if isinstance(one, dict)]
        if isinstance(drones, list)
        else []
    )
    return [drone for drone in tables if str(drone.get("uri")).startswith("radio://")]


def _replace_channel(uri: str, channels: Mapping[str, int]) -> str:
    match = URI_SEARCH.radio_uri.fullmatch(uri)
    if match is None or _dongle_name(match) not in channels:
        return uri
    return f"{match[1]}{channels[_dongle_name(match)]}{match[4]}"


def _dongle_name(match: re.Match[str]) -> str:
    """Return the dongle of a uri: its number in plain digits, or its serial number."""
    name = match[2]
    return (
        str(int(name))
        if name.isdecimal() and len(name) < URI_SEARCH.serial_digits
        else name.upper()
    )


def _replace_in_token(token: re.Match[str], channels: Mapping[str, int]) -> str:
    """Return a text or comment, with another channel if it is the value of a key `uri`."""
    written = token[0]
    before = token.string[
        max(token.start() - URI_SEARCH.key_distance, 0) : token.start()
    ]
    return (
        written[0] + _replace_channel(written[1:-1], channels) + written[-1]
        if URI_SEARCH.uri_key.search(before)
        else written
    )
