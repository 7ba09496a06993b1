"""The counts that a link shows: frames sent, received, refused and dropped."""

from dataclasses import dataclass

FAULT_TEXTS = {
    "full": "frames dropped, because a process of this host reads too slowly",
    "broken": "connections broken",
    "overtaken": "control messages overtaken by newer ones",
    "flooded": "frames dropped, because a host sends too many",
}
"""Counts that the operator sees during a flight, unless they are zero, with what they count."""


@dataclass
class LinkCounters:
    """Counts of frames on the network, sent, received and dropped."""

    frames_sent: int = 0
    """Frames sent."""
    frames_received: int = 0
    """Frames received from peers."""
    bytes_sent: int = 0
    """Bytes of the sent frames."""
    malformed: int = 0
    """Frames and messages that could not be decoded, and packets that are no frames."""
    other_version: int = 0
    """Frames of another version of the format."""
    strangers: int = 0
    """Frames and messages of processes without a token (or with a HELLO
    that overtook it), or in the name of another process; connections of
    another user, another swarm, or an unknown process of this host.
    """
    forbidden: int = 0
    """Commands of hosts that are not operators."""
    unsendable: int = 0
    """Messages that fit into no frame."""
    dropped: int = 0
    """Messages for a peer that went away."""
    overflowed: int = 0
    """Frames dropped because the event loop hung."""
    flooded: int = 0
    """Frames and tokens dropped because their host sends too many."""
    failed: int = 0
    """Frames with a handler that raised an error."""
    put_errors: int = 0
    """Frames that Zenoh refused to send."""
    full: int = 0
    """Frames dropped because a process of this host does not read fast enough."""
    overtaken: int = 0
    """Control messages that were dropped because a newer one came first, through a socket."""
    broken: int = 0
    """Connections to processes of this host that ended with an error."""
    tokens: int = 0
    """Additional tokens, declared because another process lost ours."""
    worst_put_s: float = 0.0
    """s: longest put."""

    def list_faults(self) -> list[str]:
        """Return the text and the value of each of FAULT_TEXTS that is not zero."""
        counts = {text: getattr(self, name) for name, text in FAULT_TEXTS.items()}
        return [f"{text}: {count}" for text, count in counts.items() if count]
