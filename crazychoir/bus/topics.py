"""The table of all topics.

Mailboxes, frames, impairment, latching and public keys are derived from it.
"""

from dataclasses import dataclass
from enum import IntEnum
from types import UnionType
from typing import Any, Literal, get_args

from crazychoir.runtime.clock import Clock
from crazychoir.runtime.mailbox import AnyMailbox, DropOldest, Latest
from crazychoir.types import (
    Body,
    Command,
    FullState,
    LinkStatus,
    Plan,
    Pose,
    State,
    Status,
)


class Class(IntEnum):
    """The treatment of a message on its way.

    The key of a frame has the name, the frame the number.
    """

    ESTOP = 0
    """Resent until every drone has acknowledged."""
    CONTROL = 1
    """Only the newest message counts; the sender drops older ones that still wait."""
    ROUNDS = 2
    """Best effort; the round algorithm resends missing messages."""
    RELIABLE = 3
    """Sequence numbers, acknowledgements and retransmission."""
    BULK = 4
    """Lowest priority, for everything that can wait."""


@dataclass(frozen=True)
class Topic:
    """One row of the table."""

    number: int
    """Number of the topic in a frame."""
    name: str
    """Name of the topic."""
    type: type[Any] | UnionType | None
    """Type of its values, one or several; None for any."""
    rate: float
    """Hz at which the sender publishes; 0 for when needed."""
    max_age: float
    """Seconds after which a value is stale."""
    queue: int
    """0 for a mailbox with the latest value, n for the n newest values."""
    klass: Class
    """Class of its messages."""
    latched: bool = False
    """True if a new reader gets the last value at once."""
    impaired: bool = True
    """True if the simulated network acts on it between drones."""
    public: float = 0.0
    """Hz of the copy for other Zenoh programs; 0 for none."""
    wire: Literal["edge", "interest", "process"] = "interest"
    """Receivers: the neighbours along an edge, all ports with an interest, or a process."""
    of_body: bool = False
    """True if the process with the drone's body publishes it,
    which may be another one than the drone's.
    """

    @property
    def allowed(self) -> str:
        """Names of the types of its values."""
        kinds = get_args(self.type) or (self.type,)
        return " | ".join(kind.__name__ for kind in kinds) if self.type else "any"

    def mailbox(self, clock: Clock, name: str = "") -> AnyMailbox:
        """Return a mailbox with this topic's policy."""
        if self.queue:
            return DropOldest(clock, f"{name}{self.name}", self.queue)
        return Latest(clock, f"{name}{self.name}", self.max_age)


NEVER_STALE = float("inf")
"""Maximum age of values that never become stale."""

# From one drone's actors to each other and to observers.
POSE = Topic(1, "pose", Pose, 100, 0.1, 0, Class.CONTROL, impaired=False, of_body=True)
"""Pose of the drone, from cameras or from its own estimator."""
STATE = Topic(2, "state", State, 100, 0.25, 0, Class.CONTROL, public=10)
"""Estimated state of the drone."""
REFERENCE = Topic(3, "reference", FullState, 100, 0.5, 0, Class.CONTROL, impaired=False)
"""Reference that the drone tracks."""
COMMAND = Topic(4, "command", Command, 100, 0.1, 0, Class.CONTROL, impaired=False)
"""Command to the motors or the firmware."""
TRUTH = Topic(
    5, "truth", State, 20, 0.5, 0, Class.CONTROL, impaired=False, of_body=True
)
"""True state in simulation, else the best measurement."""
STATUS = Topic(
    6,
    "status",
    Status,
    4,
    2.0,
    0,
    Class.CONTROL,
    latched=True,
    impaired=False,
    public=2,
)
"""Status of the drone, for people."""
RESULT = Topic(
    7, "result", dict, 0, NEVER_STALE, 0, Class.BULK, latched=True, impaired=False
)
"""Result of the mission."""
LOG = Topic(8, "log", str, 0, NEVER_STALE, 256, Class.BULK, impaired=False)
"""Log lines of the drone."""
BODY = Topic(
    9,
    "body",
    Body,
    4,
    1.0,
    0,
    Class.CONTROL,
    latched=True,
    impaired=False,
    of_body=True,
)
"""State of the drone's body."""
LINK = Topic(
    15,
    "link",
    LinkStatus,
    10,
    0.5,
    0,
    Class.CONTROL,
    latched=True,
    impaired=False,
    of_body=True,
)
"""State of the radio link."""
TELEMETRY = Topic(
    11, "telemetry", dict, 100, 0.25, 0, Class.CONTROL, impaired=False, of_body=True
)
"""Log variables of the drone."""
PLAN = Topic(12, "plan", Plan, 20, 0.5, 0, Class.CONTROL)
"""Path that the drone is going to fly."""
# From a drone to its body in another process: it replaces COMMAND after the motors are cut.
CUT = Topic(
    10, "cut", None, 0, NEVER_STALE, 0, Class.CONTROL, impaired=False, wire="edge"
)
"""Cut of the motors."""
# Along the edges of the graph.
ROUND = Topic(16, "round", None, 0, NEVER_STALE, 0, Class.ROUNDS, wire="edge")
"""Messages of round algorithms."""
HEARTBEAT = Topic(17, "heartbeat", None, 4, 1.0, 0, Class.CONTROL, wire="edge")
"""Sign of life, with the state of the team."""
ROSTER = Topic(18, "roster", None, 0, NEVER_STALE, 0, Class.RELIABLE, wire="edge")
"""Messages about the composition of the team."""
ACK = Topic(19, "ack", None, 0, NEVER_STALE, 0, Class.ROUNDS, wire="edge")
"""Acknowledgements of reliable messages."""
# Commands of operators.
REQUEST = Topic(
    24, "request", None, 0, NEVER_STALE, 0, Class.ROUNDS, impaired=False, wire="edge"
)
"""Commands of operators."""
ANSWER = Topic(
    25, "answer", None, 0, NEVER_STALE, 0, Class.ROUNDS, impaired=False, wire="edge"
)
"""Answers to commands."""
ESTOP = Topic(
    26, "estop", None, 0, NEVER_STALE, 0, Class.ESTOP, impaired=False, wire="edge"
)
"""Emergency stop, or its end."""
# Between any two drones: a request for missing states of other drones, and the answer.
SOUGHT = Topic(13, "sought", None, 0, NEVER_STALE, 0, Class.CONTROL, wire="edge")
"""Request for missing states of other drones."""
HEARSAY = Topic(14, "hearsay", None, 0, NEVER_STALE, 0, Class.CONTROL, wire="edge")
"""States of other drones, as the sender received them."""
# Between processes.
HELLO = Topic(
    32, "hello", None, 1, NEVER_STALE, 0, Class.ROUNDS, impaired=False, wire="process"
)
"""Description of a process."""
CLOCK = Topic(
    33, "clock", None, 1, NEVER_STALE, 0, Class.ROUNDS, impaired=False, wire="process"
)
"""Times, to estimate the offset of clocks."""

TOPICS = (
    POSE,
    STATE,
    REFERENCE,
    COMMAND,
    TRUTH,
    STATUS,
    RESULT,
    LOG,
    BODY,
    LINK,
    TELEMETRY,
    CUT,
    PLAN,
    ROUND,
    HEARTBEAT,
    ROSTER,
    ACK,
    REQUEST,
    ANSWER,
    ESTOP,
    SOUGHT,
    HEARSAY,
    HELLO,
    CLOCK,
)
"""All topics."""
BY_NAME = {topic.name: topic for topic in TOPICS}
"""Topics by name."""
BY_NUMBER = {topic.number: topic for topic in TOPICS}
"""Topics by number."""
OBSERVABLE = tuple(topic.name for topic in TOPICS if topic.wire == "interest")
"""Names of the topics that an observer may ask for."""
