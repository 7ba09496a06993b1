"""How long the way to a drone and back takes: echoes over cflib's links, without a connection to the drone behind.

A link alone has no tables to fetch, no zero set-point at its end, and no thread that waits for a silent peer for ever.
"""

import contextlib
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.config.uris import parse_uri
from crazychoir.errors import ConfigError
from crazychoir.radio.link.dongles import PLUG
from crazychoir.radio.link.round_trips import ECHO, FORM
from crazychoir.radio.protocol.crtp import LINK

PATIENCE = 0.2
"""s after which an echo is lost."""
FIRST = 3.0
"""s after which nobody is there."""
CLOSING = 3.0
"""s that cflib may take to open or close a link, beyond the deadline."""
NOBODY = "nobody answers. Is it on, in reach, and not connected to somebody else?"


@dataclass(frozen=True)
class Echoes:
    """sent: how many;  round_trip: s of those that came back;  error: why it ended early, or nothing."""

    uri: str
    sent: int
    round_trip: tuple[float, ...]
    error: str = ""

    @property
    def lost(self) -> int:
        """How many did not come back in time."""
        return self.sent - len(self.round_trip)

    def percentile(self, share: float) -> float | None:
        """s within which this share (%) of those that came back did; None if none has."""
        return float(np.percentile(self.round_trip, share)) if self.round_trip else None


def require_uri(uri: str) -> str:
    """Return the one form of a uri; raise ConfigError for one that cflib has no link for, or that we do not ping."""
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
) -> list[Echoes]:
    """Send `count` echoes to each, to all at once, each after the answer to the last; s until it ends at the latest.

    Each link has a thread, which is gone in the end; of one that cflib does not give back the error says so.
    """
    found: dict[str, Echoes] = {}
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
        thread.join(max(end + CLOSING - now(), 0.0))
    hangs = f"cflib does not come back: {NOBODY}"
    return [found.get(uri, Echoes(uri, 0, (), hangs)) for uri in uris]


def _collect(
    found: dict[str, Echoes], uri: str, now: Callable[[], float], count: int, end: float
) -> None:
    try:
        found[uri] = _ping(uri, now, count, end)
    except Exception as error:  # noqa: BLE001 - cflib raises nothing more special
        found[uri] = Echoes(
            uri, 0, (), f"{error}. {PLUG}" if uri.startswith("radio:") else str(error)
        )


def _ping(uri: str, now: Callable[[], float], count: int, end: float) -> Echoes:
    errors: list[str] = []
    link = _link(uri)
    try:
        link.connect(uri, None, errors.append)
        return _exchange(link, uri, now, count, end, errors)
    finally:
        with contextlib.suppress(
            AttributeError
        ):  # of cflib's radio link, if it has not come to start its thread
            link.close()


def _link(uri: str) -> Any:
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
) -> Echoes:
    """Echo after echo; `errors` grows as the link finds them."""
    sent = 0
    took: list[float] = []
    first = min(now() + FIRST, end)
    while sent < count and not errors and now() < (end if took else first):
        began = now()
        link.send_packet(_echo(sent))
        if _comes_back(link, sent, now, min(began + PATIENCE, end)):
            took.append(now() - began)
        sent += 1
    return Echoes(uri, sent, tuple(took), _error(errors, bool(took), count - sent))


def _error(errors: Sequence[str], heard: bool, left: int) -> str:
    """Why it ended before all echoes were sent, or without any answer; nothing if it did not."""
    if not heard:
        return ": ".join([*map(_reason, errors[:1]), NOBODY])
    if errors:
        return _reason(errors[0])
    return f"{left} more echoes were to be sent at the deadline" if left else ""


def _echo(number: int) -> Any:
    from cflib.crtp.crtpstack import CRTPPacket

    packet = CRTPPacket()
    packet.set_header(LINK, ECHO)
    packet.data = FORM.pack(0, number)
    return packet


def _comes_back(link: Any, number: int, now: Callable[[], float], until: float) -> bool:
    """Wait for this echo; whatever else comes is passed over, late echoes too."""
    expected = (LINK, ECHO, FORM.pack(0, number))
    while (
        left := until - now()
    ) > 0.0:  # cflib takes 0 for not at all, and less for ever
        packet = link.receive_packet(left)
        if (
            packet is not None
            and (packet.port, packet.channel, bytes(packet.data)) == expected
        ):
            return True
    return False


def _reason(text: str) -> str:
    """What cflib says before its traceback, without saying that it is an exception."""
    return " ".join(text.split("\n\n")[0].split("Exception:")[-1].split())
