"""The uris of drones with a radio: their allowed forms, and
the one form in which they are compared.

A radio:// uri is cflib's, with a dongle by its number. Other forms that cflib or crazyflie-link-cpp
know are refused with the reason. Parts that are left out have cflib's default.
"""

import re
import socket
from collections.abc import Callable
from dataclasses import dataclass
from urllib.parse import parse_qsl

from crazychoir.bus.network.endpoints import address_fault
from crazychoir.config.reader import show_value
from crazychoir.errors import ConfigError

UDP_SCHEME = "udp://"
"""Start of the uris of virtual Crazyflies."""
RADIO_SCHEME = "radio://"
"""Start of the uris of real Crazyflies."""


@dataclass(frozen=True, slots=True)
class UriRules:
    """Limits and defaults of the parts of a uri."""

    last_channel: int = 125
    """Largest radio channel."""
    last_dongle: int = 15
    """Largest number of a dongle."""
    last_port: int = 65535
    """Largest UDP port."""
    data_rates: tuple[str, ...] = ("250K", "1M", "2M")
    """Data rates of the radio."""
    default_rate: str = "2M"
    """Data rate if the uri has none."""
    default_address: str = "E7E7E7E7E7"
    """Address of a new Crazyflie."""
    unlimited_number: int = 10**9
    """Larger than any number that a uri may have."""
    link_options: tuple[str, ...] = ("safelink", "autoping", "ackfilter")
    """Options of crazyflie-link-cpp."""
    address_pattern: re.Pattern[str] = re.compile(r"[0-9A-Fa-f]{10}")
    """Address of a Crazyflie: 10 hexadecimal digits."""


URI_RULES = UriRules()


UDP_FORM = "udp://HOST:PORT, as udp://127.0.0.1:19850"
"""Form of a udp:// uri, for errors."""
RADIO_FORM = (
    "radio://DONGLE/CHANNEL/RATE/ADDRESS, as radio://0/80/2M/E7E7E7E703: a dongle of 0 to 15, a channel of 0 to 125, "
    "250K, 1M or 2M, an address of 10 hexadecimal digits; without them "
    f"{URI_RULES.default_rate} and {URI_RULES.default_address}"
)
"""Form of a radio:// uri, for errors."""
_THIS_MACHINE = "127.0.0.1"
_NAMES_OF_THIS_MACHINE = ("localhost", "localhost.localdomain", "0.0.0.0")  # noqa: S104 - nothing listens by it here


@dataclass(frozen=True)
class UdpUri:
    """The address of a virtual Crazyflie."""

    host: str
    """An IPv4 address in four numbers, or a name in small letters."""
    port: int
    """UDP port."""

    def __str__(self) -> str:
        return f"{UDP_SCHEME}{self.host}:{self.port}"

    @property
    def drone(self) -> tuple[object, ...]:
        """Value that is equal for two uris of the same drone."""
        host = _THIS_MACHINE if self.host in _NAMES_OF_THIS_MACHINE else self.host
        return UDP_SCHEME, host, self.port


@dataclass(frozen=True)
class RadioUri:
    """The address of a Crazyflie behind a dongle."""

    dongle: str
    """Number of the dongle, or, if that is allowed, its serial number."""
    channel: int
    """Radio channel."""
    rate: str
    """Data rate, one of URI_RULES.data_rates."""
    address: str
    """10 hexadecimal digits, capitals."""
    rate_limit: int | None = None
    """Packets a second; None: no limit."""

    def __str__(self) -> str:
        limit = "" if self.rate_limit is None else f"?rate_limit={self.rate_limit}"
        return f"{RADIO_SCHEME}{self.dongle}/{self.channel}/{self.rate}/{self.address}{limit}"

    @property
    def drone(self) -> tuple[object, ...]:
        """Value that is equal for two uris of the same drone; any dongle reaches it."""
        return RADIO_SCHEME, self.channel, self.rate, self.address


Uri = UdpUri | RadioUri


def parse_uri(uri: str, key: str, serials: bool = False) -> Uri:
    """Return the parts of a udp:// or radio:// uri.

    key: the key of the uri, for errors
    serials: True if a dongle may be named by its serial number
    Raises ConfigError if no driver here can open the uri.
    """
    if uri.startswith(UDP_SCHEME):
        return _parse_udp(uri, key)
    return _parse_radio(uri, key, serials)


def udp_uri(uri: str) -> UdpUri | None:
    """Return the parts of a checked uri if it begins with udp://, else None."""
    return _parse_udp(uri, "uri") if uri.startswith(UDP_SCHEME) else None


def radio_uri(uri: str) -> RadioUri | None:
    """Return the parts of a checked uri if it begins with radio://, else None."""
    return (
        _parse_radio(uri, "uri", serials=False)
        if uri.startswith(RADIO_SCHEME)
        else None
    )


def canonical_uri(uri: str) -> str:
    """Return the one form of a checked uri; the uri of a simulated world is returned as it is."""
    return (
        str(parse_uri(uri, "uri"))
        if uri.startswith((UDP_SCHEME, RADIO_SCHEME))
        else uri
    )


def _parse_udp(uri: str, key: str) -> UdpUri:
    """Return the parts of a udp:// uri; raise ConfigError if it is invalid."""
    place, mark, _ = uri.removeprefix(UDP_SCHEME).partition("?")
    place = place.removesuffix("/")
    if mark:
        raise ConfigError(
            key,
            show_value(uri),
            UDP_FORM,
            "A udp:// uri has no options: remove everything from the ? on.",
        )
    if place.startswith("[") or place.count(":") > 1:
        raise ConfigError(
            key,
            show_value(uri),
            UDP_FORM,
            "The udp:// link of cflib supports IPv4 only: write an IPv4 address.",
        )
    host, colon, port = place.partition(":")
    if not colon:
        raise ConfigError(
            key,
            show_value(uri),
            UDP_FORM,
            f"Write its port, as {UDP_SCHEME}{host or _THIS_MACHINE}:19850.",
        )
    if not (
        port.isascii()
        and port.isdecimal()
        and 1 <= _number(port) <= URI_RULES.last_port
    ):
        raise ConfigError(
            key,
            show_value(uri),
            UDP_FORM,
            f"A port is a number of 1 to {URI_RULES.last_port}.",
        )
    host = _normalise_host(host)
    if host not in _NAMES_OF_THIS_MACHINE and (fault := address_fault(host)):
        raise ConfigError(key, show_value(uri), UDP_FORM, fault)
    return UdpUri(
        _THIS_MACHINE if host.startswith("localhost") else host, _number(port)
    )


def _normalise_host(text: str) -> str:
    """Return the host as it is compared: in small letters, an IPv4 address in four numbers."""
    host = text.lower().removesuffix(".")
    try:
        return (
            socket.inet_ntoa(socket.inet_aton(host))
            if host[:1].isdigit() and " " not in host
            else host
        )
    except OSError:
        return host


def _parse_radio(uri: str, key: str, serials: bool) -> RadioUri:
    """Return the parts of a radio:// uri; raise ConfigError if it is invalid."""
    place, _, query = uri.removeprefix(RADIO_SCHEME).partition("?")
    parts = place.removesuffix("/").split("/")

    def refused(do: str) -> ConfigError:
        return ConfigError(key, show_value(uri), RADIO_FORM, do)

    if not uri.startswith(RADIO_SCHEME):
        raise refused("")
    if len(parts) < 2:
        raise refused("Write its channel, as radio://0/80.")
    if len(parts) > 4:
        raise refused("Remove everything after the address.")
    dongle, channel = parts[:2]
    rate = parts[2] if len(parts) > 2 else URI_RULES.default_rate
    address = parts[3] if len(parts) > 3 else URI_RULES.default_address
    if fault := _dongle_fault(dongle, serials):
        raise refused(fault)
    if not (
        channel.isascii()
        and channel.isdecimal()
        and _number(channel) <= URI_RULES.last_channel
    ):
        raise refused(f"A channel is a number of 0 to {URI_RULES.last_channel}.")
    if rate not in URI_RULES.data_rates:
        raise refused(
            f"Write {rate.upper()}." if rate.upper() in URI_RULES.data_rates else ""
        )
    if not URI_RULES.address_pattern.fullmatch(address):
        raise refused(_address_hint(address))
    number = (
        str(_number(dongle))
        if dongle.isdecimal() and len(dongle) < 10
        else dongle.upper()
    )
    return RadioUri(
        number, _number(channel), rate, address.upper(), _rate_limit(query, refused)
    )


def _dongle_fault(dongle: str, serials: bool) -> str:
    """Return what to do about an invalid dongle; empty for a valid one."""
    if dongle == "*":
        return "For crazyflie-link-cpp * is any dongle; here each dongle has an owner: write its number, as radio://0."
    if URI_RULES.address_pattern.fullmatch(dongle):
        number = "cflib finds a dongle by its serial number; here its owner, `crazychoir-radio --dongle`, goes by its"
        return (
            ""
            if serials
            else f"{number} number on the host: write that, 0 for the first. See `crazychoir doctor`."
        )
    if (
        dongle.isascii()
        and dongle.isdecimal()
        and _number(dongle) <= URI_RULES.last_dongle
    ):
        return ""
    return f"A dongle is a number of 0 to {URI_RULES.last_dongle}."


def _address_hint(address: str) -> str:
    """Return advice for a short address, or an empty text."""
    if re.fullmatch(r"[0-9A-Fa-f]{1,9}", address):
        return f"Write all 10 digits: cflib would read it as {address.upper():0>10}."
    return ""


def _rate_limit(query: str, refused: Callable[[str], ConfigError]) -> int | None:
    """Return the packets a second of ?rate_limit=, None without it.

    Raises `refused` for any other option.
    """
    limit = None
    for name, value in parse_qsl(query, keep_blank_values=True):
        if name in URI_RULES.link_options:
            raise refused(
                f"{name} is an option of crazyflie-link-cpp: leave it out; here safelink is always on."
            )
        if name != "rate_limit":
            raise refused(
                f"There is no option {name}: leave it out. There is rate_limit, in packets a second."
            )
        if limit is not None:
            raise refused("Write rate_limit once.")
        if not (
            value.isascii()
            and value.isdecimal()
            and 1 <= _number(value) < URI_RULES.unlimited_number
        ):
            raise refused(
                "rate_limit is a whole number of packets a second, 1 or more."
            )
        limit = _number(value)
    return limit


def _number(digits: str) -> int:
    """Return a number of at most nine digits; a longer one becomes unlimited_number."""
    stripped = digits.lstrip("0") or "0"
    return int(stripped) if len(stripped) < 10 else URI_RULES.unlimited_number
