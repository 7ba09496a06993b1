"""Round-trip times of echoes over cflib's links, without a connection to the drone.

A full connection of cflib would load tables, send a zero set-point at its end, and wait for a
silent drone for ever. A link does none of this.
"""

import contextlib
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.config.uris import parse_uri
from crazychoir.errors import ConfigError
from crazychoir.firmware.requests import LINK_CHANNELS
from crazychoir.radio.link.dongles import PLUG_ADVICE
from crazychoir.radio.link.round_trips import ECHO_FORMAT
from crazychoir.radio.protocol.crtp import CrtpPort


@dataclass(frozen=True, slots=True)
class PingTiming:
    """Deadlines of echoes and links."""

    echo_timeout: float = 0.2
    """s: time after which an echo counts as lost."""
    first_answer_timeout: float = 3.0
    """s without any answer after which the drone counts as absent."""
    closing_time: float = 3.0
    """s after the deadline in which cflib may open or close a link."""


PING_TIMING = PingTiming()


NO_ANSWER_TEXT = (
    "no answer. Is the drone on, in reach, and not connected to another program?"
)
"""Text of the error for a drone that does not answer."""


@dataclass(frozen=True)
class PingResult:
    """The result of a ping."""

    uri: str
    """Address of the drone."""
    sent: int
    """Echoes sent."""
    round_trip: tuple[float, ...]
    """s: round trips of the echoes that came back."""
    error: str = ""
    """Reason why the ping ended early; empty if it did not."""

    @property
    def lost(self) -> int:
        """Echoes that did not come back in time."""
        return self.sent - len(self.round_trip)

    def percentile(self, share: float) -> float | None:
        """Return the time in s within which `share` % of the returned echoes came back.

        Returns None if no echo came back.
        """
        return float(np.percentile(self.round_trip, share)) if self.round_trip else None


def require_uri(uri: str) -> str:
    """Return a uri in its standard form.

    Raises ConfigError if cflib has no link for it, or it cannot be pinged.
    """
    try:
        return str(parse_uri(uri, "uri", serials=True))
    except ConfigError as error:
        allowed = "udp://HOST:PORT or radio://DONGLE/CHANNEL/RATE/ADDRESS, as radio://0/80/2M/E7E7E7E701"
        raise ConfigError("uri", uri, allowed, error.do) from None


def ping(
    uris: Sequence[str],
    now: Callable[[], float],
    count: int = 100,
    deadline: float = 20.0,
) -> list[PingResult]:
    """Send echoes to each uri, one after another, and return one result for each uri.

    All uris are served at the same time, each in its own thread.

    now: returns the time in s
    count: echoes for each uri
    deadline: s after which the ping ends in any case; a call of cflib that hangs then is reported
        in the error of its result
    """
    found: dict[str, PingResult] = {}
    end = now() + deadline
    threads = [
        threading.Thread(
            target=_collect, args=(found, uri, now, count, end), daemon=True
        )
        for uri in uris
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(max(end + PING_TIMING.closing_time - now(), 0.0))
    hangs = f"cflib does not come back: {NO_ANSWER_TEXT}"
    return [found.get(uri, PingResult(uri, 0, (), hangs)) for uri in uris]


def _collect(
    found: dict[str, PingResult],
    uri: str,
    now: Callable[[], float],
    count: int,
    end: float,
) -> None:
    try:
        found[uri] = _ping(uri, now, count, end)
    except Exception as error:  # noqa: BLE001 - cflib raises nothing more special
        found[uri] = PingResult(
            uri,
            0,
            (),
            f"{error}. {PLUG_ADVICE}" if uri.startswith("radio:") else str(error),
        )


def _ping(uri: str, now: Callable[[], float], count: int, end: float) -> PingResult:
    errors: list[str] = []
    link = _make_link(uri)
    try:
        link.connect(uri, None, errors.append)
        return _exchange(link, uri, now, count, end, errors)
    finally:
        # cflib's radio link raises AttributeError if its thread has not started.
        with contextlib.suppress(AttributeError):
            link.close()


def _make_link(uri: str) -> Any:
    from cflib.crtp.radiodriver import RadioDriver
    from cflib.crtp.udpdriver import UdpDriver

    return UdpDriver() if uri.startswith("udp:") else RadioDriver()


def _exchange(
    link: Any,
    uri: str,
    now: Callable[[], float],
    count: int,
    end: float,
    errors: Sequence[str],
) -> PingResult:
    """Send echo after echo; `errors` grows while the link finds errors."""
    sent = 0
    took: list[float] = []
    first = min(now() + PING_TIMING.first_answer_timeout, end)
    while sent < count and not errors and now() < (end if took else first):
        began = now()
        link.send_packet(_make_echo(sent))
        if _comes_back(link, sent, now, min(began + PING_TIMING.echo_timeout, end)):
            took.append(now() - began)
        sent += 1
    return PingResult(
        uri, sent, tuple(took), _describe_error(errors, bool(took), count - sent)
    )


def _describe_error(errors: Sequence[str], heard: bool, left: int) -> str:
    """Return why the ping ended early, or that there was no answer.

    The text is empty if neither is the case.
    """
    if not heard:
        return ": ".join([*map(_short_reason, errors[:1]), NO_ANSWER_TEXT])
    if errors:
        return _short_reason(errors[0])
    return f"{left} more echoes were to be sent at the deadline" if left else ""


def _make_echo(number: int) -> Any:
    from cflib.crtp.crtpstack import CRTPPacket

    packet = CRTPPacket()
    packet.set_header(CrtpPort.LINK, LINK_CHANNELS.echo)
    packet.data = ECHO_FORMAT.pack(0, number)
    return packet


def _comes_back(link: Any, number: int, now: Callable[[], float], until: float) -> bool:
    """Wait for this echo; return whether it came. Other packets, and late echoes, are ignored."""
    expected = (CrtpPort.LINK, LINK_CHANNELS.echo, ECHO_FORMAT.pack(0, number))
    # cflib would not wait at all for 0 s, and would wait for ever for less.
    while (left := until - now()) > 0.0:
        packet = link.receive_packet(left)
        if (
            packet is not None
            and (packet.port, packet.channel, bytes(packet.data)) == expected
        ):
            return True
    return False


def _short_reason(text: str) -> str:
    """Return the text before cflib's traceback, without the word Exception."""
    return " ".join(text.split("\n\n")[0].split("Exception:")[-1].split())
