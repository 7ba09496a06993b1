"""Logs connections that fail because of a certificate, once each.

Zenoh reports them only in its own log, on standard output, where results belong. Therefore this
module replaces standard output: text that Python prints goes to a copy of it, and all other text is
read here. Lines that are not Zenoh's go to standard error.
"""

import logging
import os
import re
import sys
import threading
from dataclasses import dataclass

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ZenohLogReading:
    """How the log of Zenoh is read."""

    log_levels: str = (
        "zenoh::net::runtime::orchestrator=debug,"
        "zenoh_link_tls=warn,zenoh_link_quic=warn,zenoh_link_commons=warn"
    )
    """Log levels of Zenoh."""
    output_descriptor: int = 1
    """File descriptor of standard output."""
    max_reports: int = 64
    """Most different log lines, so that an intruder cannot fill the log."""


ZENOH_LOG_READING = ZenohLogReading()


@dataclass(frozen=True, slots=True)
class _LogPatterns:
    """Patterns of the lines of Zenoh's log."""

    colour: re.Pattern[str] = re.compile(r"\x1b\[[0-9;]*m")
    """Escape sequence of a terminal."""
    line: re.Pattern[str] = re.compile(
        r"^\S+Z +(?:WARN|INFO|DEBUG|ERROR) .*?(?P<module>zenoh\w*(?:::\w+)*): (?P<text>.*)$"
    )
    """Line of Zenoh's log."""
    incoming_failure: re.Pattern[str] = re.compile(r"^(?P<why>.*?)\.? Hint: ")
    """Failed connection of another host to us."""
    outgoing_failure: re.Pattern[str] = re.compile(
        r"^Unable to connect to configured \w+ (?P<where>\S+)! (?P<why>.*?) at /"
    )
    """Failed connection of ours to another host."""
    certificate_error: re.Pattern[str] = re.compile(
        r"certificate|alert|handshake|InvalidContentType", re.IGNORECASE
    )
    """Text of an error that concerns certificates."""


_LOG_PATTERNS = _LogPatterns()


class HandshakeReporter:
    """Reads the lines of Zenoh's log and reports those about certificates."""

    def __init__(self) -> None:
        self._said: set[tuple[str, str]] = set()

    def line(self, text: str) -> bool:
        """Handle a line; return False if it is not Zenoh's."""
        found = _LOG_PATTERNS.line.match(_LOG_PATTERNS.colour.sub("", text))
        if found is None:
            return False
        if "_link_" in found["module"] and (
            why := _LOG_PATTERNS.incoming_failure.match(found["text"])
        ):
            self._say(
                "a process connected and was refused",
                why["why"],
                "Nothing of it was read",
            )
        elif (
            to := _LOG_PATTERNS.outgoing_failure.match(found["text"])
        ) and _LOG_PATTERNS.certificate_error.search(to["why"]):
            fault = f"{to['where']} and we do not accept each other's certificate"
            self._say(fault, to["why"].rpartition("): ")[2], "See `crazychoir doctor`")
        return True

    def _say(self, what: str, why: str, then: str) -> None:
        told = (what, re.sub(r"\d+", "", why))  # the text may contain the time of day
        if told not in self._said and len(self._said) < ZENOH_LOG_READING.max_reports:
            self._said.add(told)
            log.warning("%s: %s. %s", what, why, then)


class _OutputReader:
    """The state of this process, which has only one standard output."""

    begun = False


def read_output() -> None:
    """Begin to read standard output, once for each process.

    Nothing happens if standard output is not ours to replace, or if RUST_LOG asks for the whole
    log.
    """
    if _OutputReader.begun or "RUST_LOG" in os.environ:
        return
    try:
        ours = sys.stdout.fileno() == ZENOH_LOG_READING.output_descriptor
    except (OSError, ValueError, AttributeError):  # for example in a test
        return
    if not ours:
        return
    _OutputReader.begun = True
    sys.stdout.flush()
    copy = os.dup(ZENOH_LOG_READING.output_descriptor)
    read, write = os.pipe()
    os.dup2(write, ZENOH_LOG_READING.output_descriptor)
    os.close(write)
    sys.stdout = os.fdopen(
        copy, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors
    )
    threading.Thread(
        target=_read_lines, args=(read,), name="zenoh log", daemon=True
    ).start()


def is_reading_output() -> bool:
    """Return True if this process reads text on standard output that Python did not write."""
    return _OutputReader.begun


def _read_lines(read: int) -> None:
    heard = HandshakeReporter()
    with os.fdopen(read, errors="replace") as lines:
        for text in lines:
            if text.strip() and not heard.line(text.rstrip("\n")):
                sys.stderr.write(text)
