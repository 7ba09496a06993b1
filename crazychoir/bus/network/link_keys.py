"""The keys of a swarm in Zenoh.

frames  choir/<swarm>/f/<destination process>/<source host>/<source process>/<class>
tokens  choir/<swarm>/live/<host>/<process>[/<number>]    numbered ones: see lost_tokens.py
public  choir/<swarm>/drone/<drone>/<topic>
"""

from dataclasses import dataclass
from typing import Final

from crazychoir.bus.network.endpoints import check_name
from crazychoir.bus.topics import MessageClass

FRAME_KEY_PARTS: Final = 7
"""Parts of the key of a frame."""


@dataclass(frozen=True, slots=True)
class LinkKeys:
    """The keys that a process declares, and to which it sends.

    Raises ConfigError for a name that cannot be part of a key.
    """

    swarm: str
    """Name of the swarm."""
    host: str
    """Name of the host of this process."""
    process: str
    """Name of this process."""

    def __post_init__(self) -> None:
        check_name("swarm", self.swarm)
        check_name("host", self.host)
        check_name("process", self.process)

    @property
    def arriving_frames(self) -> str:
        """Keys of all frames for this process."""
        return f"choir/{self.swarm}/f/{self.process}/**"

    @property
    def all_tokens(self) -> str:
        """Keys of the tokens of all processes."""
        return f"choir/{self.swarm}/live/*/*/**"

    @property
    def own_token(self) -> str:
        """Key of the token of this process."""
        return f"choir/{self.swarm}/live/{self.host}/{self.process}"

    def frame_to(self, process: str, klass: MessageClass) -> str:
        """Return the key of the frames of a class to another process."""
        return f"choir/{self.swarm}/f/{process}/{self.host}/{self.process}/{klass.name.lower()}"

    def public(self, drone: int | str, name: str) -> str:
        """Return the key of what a drone publishes for other Zenoh programs; "*": of all drones."""
        return f"choir/{self.swarm}/drone/{drone}/{name}"


def read_sender(key: str) -> tuple[str, str]:
    """Return the host and the process in the key of a frame,
    where access control looks for the host.

    Returns two empty texts if the key does not have FRAME_KEY_PARTS parts.
    """
    parts = key.split("/")
    return (parts[4], parts[5]) if len(parts) == FRAME_KEY_PARTS else ("", "")


def read_token(key: str) -> tuple[str, str]:
    """Return the host and the process in the key of a token."""
    host, process, *_ = key.split("/")[3:]
    return host, process
