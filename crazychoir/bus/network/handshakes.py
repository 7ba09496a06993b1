"""Connections that fail for a certificate: said in our log, once each.

Zenoh tells of them in its own log alone, and writes that to standard output, where results belong. So standard output
is taken from under it: what Python prints goes to a copy, and whatever else is written there is read here. What is not
Zenoh's goes to standard error.
"""

import logging
import os
import re
import sys
import threading

log = logging.getLogger(__name__)
WANTED = "zenoh::net::runtime::orchestrator=debug,zenoh_link_tls=warn,zenoh_link_quic=warn,zenoh_link_commons=warn"
"""What Zenoh is to write."""
STDOUT = 1
MOST = 64
"""Different things that are said; an intruder may not fill the log."""
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_ZENOH = re.compile(
    r"^\S+Z +(?:WARN|INFO|DEBUG|ERROR) .*?(?P<module>zenoh\w*(?:::\w+)*): (?P<text>.*)$"
)
_TO_US = re.compile(r"^(?P<why>.*?)\.? Hint: ")
_BY_US = re.compile(
    r"^Unable to connect to configured \w+ (?P<where>\S+)! (?P<why>.*?) at /"
)
_CERTIFICATE = re.compile(
    r"certificate|alert|handshake|InvalidContentType", re.IGNORECASE
)


class Overheard:
    """Reads what Zenoh writes, line by line, and says what concerns certificates."""

    def __init__(self) -> None:
        self._said: set[tuple[str, str]] = set()

    def line(self, text: str) -> bool:
        """Hear one; False if it is not Zenoh's."""
        found = _ZENOH.match(_COLOUR.sub("", text))
        if found is None:
            return False
        if "_link_" in found["module"] and (why := _TO_US.match(found["text"])):
            self._say(
                "somebody connected and was turned away",
                why["why"],
                "Nothing of it was read",
            )
        elif (to := _BY_US.match(found["text"])) and _CERTIFICATE.search(to["why"]):
            who = f"{to['where']} and we do not accept each other's certificate"
            self._say(who, to["why"].rpartition("): ")[2], "See `crazychoir doctor`")
        return True

    def _say(self, what: str, why: str, then: str) -> None:
        told = (what, re.sub(r"\d+", "", why))  # the time of day may be in it
        if told not in self._said and len(self._said) < MOST:
            self._said.add(told)
            log.warning("%s: %s. %s", what, why, then)


class _Listening:
    """Whether this process does: it has one standard output."""

    begun = False


def overhear() -> None:
    """Begin, once a process; not where standard output is not ours to take, or RUST_LOG asks for all of it."""
    if _Listening.begun or "RUST_LOG" in os.environ:
        return
    try:
        ours = sys.stdout.fileno() == STDOUT
    except (OSError, ValueError, AttributeError):  # a test's, say
        return
    if not ours:
        return
    _Listening.begun = True
    sys.stdout.flush()
    copy = os.dup(STDOUT)
    read, write = os.pipe()
    os.dup2(write, STDOUT)
    os.close(write)
    sys.stdout = os.fdopen(
        copy, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors
    )
    threading.Thread(
        target=_listen, args=(read,), name="zenoh log", daemon=True
    ).start()


def overhears() -> bool:
    """Whether what is written to standard output, by others than Python, is read here."""
    return _Listening.begun


def _listen(read: int) -> None:
    heard = Overheard()
    with os.fdopen(read, errors="replace") as lines:
        for text in lines:
            if text.strip() and not heard.line(text.rstrip("\n")):
                sys.stderr.write(text)
