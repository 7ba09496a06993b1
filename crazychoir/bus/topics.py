"""The table of all topics.

Mailboxes, frames, impairment, latching and public keys are derived from it.
"""

from dataclasses import dataclass, fields
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


class MessageClass(IntEnum):
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
    klass: MessageClass
    """Class of its messages."""
    latched: bool = False
    """True if a new reader gets the last value at once."""
    impaired: bool = True
    """True if the simulated network acts on it between drones."""
    public: float = 0.0
    """Hz of the copy for other Zenoh programs; 0 for none."""
    wire: Literal["edge", "interest", "swarm", "frame", "process"] = "interest"
    """Receivers: the neighbours along an edge, all ports with an interest, those of them that fly
    drones, those of them through a frame of another topic, or a process.
    """
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


@dataclass(frozen=True, slots=True)
class DroneTopics:
    """Topics that each drone publishes. Any other port may read them."""

    pose: Topic = Topic(
        1, "pose", Pose, 100, 0.1, 0, MessageClass.CONTROL, impaired=False, of_body=True
    )
    """Pose of the drone, from cameras or from its own estimator."""
    state: Topic = Topic(
        2, "state", State, 100, 0.25, 0, MessageClass.CONTROL, public=10
    )
    """Estimated state of the drone."""
    reference: Topic = Topic(
        3, "reference", FullState, 100, 0.5, 0, MessageClass.CONTROL, impaired=False
    )
    """Reference that the drone tracks."""
    command: Topic = Topic(
        4, "command", Command, 100, 0.1, 0, MessageClass.CONTROL, impaired=False
    )
    """Command to the motors or the firmware."""
    truth: Topic = Topic(
        5,
        "truth",
        State,
        20,
        0.5,
        0,
        MessageClass.CONTROL,
        impaired=False,
        of_body=True,
    )
    """True state in simulation, else the best measurement."""
    status: Topic = Topic(
        6,
        "status",
        Status,
        4,
        2.0,
        0,
        MessageClass.CONTROL,
        latched=True,
        impaired=False,
        public=2,
    )
    """Status of the drone, for people."""
    result: Topic = Topic(
        7,
        "result",
        dict,
        0,
        NEVER_STALE,
        0,
        MessageClass.BULK,
        latched=True,
        impaired=False,
    )
    """Result of the mission."""
    log: Topic = Topic(
        8, "log", str, 0, NEVER_STALE, 256, MessageClass.BULK, impaired=False
    )
    """Log lines of the drone."""
    console: Topic = Topic(
        22,
        "console",
        str,
        0,
        NEVER_STALE,
        256,
        MessageClass.BULK,
        impaired=False,
        of_body=True,
    )
    """Lines of the console of the drone's firmware."""
    body: Topic = Topic(
        9,
        "body",
        Body,
        4,
        1.0,
        0,
        MessageClass.CONTROL,
        latched=True,
        impaired=False,
        of_body=True,
    )
    """State of the drone's body."""
    telemetry: Topic = Topic(
        11,
        "telemetry",
        dict,
        100,
        0.25,
        0,
        MessageClass.CONTROL,
        impaired=False,
        of_body=True,
    )
    """Log variables of the drone."""
    plan: Topic = Topic(12, "plan", Plan, 20, 0.5, 0, MessageClass.CONTROL)
    """Path that the drone is going to fly."""
    airspace: Topic = Topic(
        20,
        "airspace",
        bytes,
        100,
        0.25,
        0,
        MessageClass.CONTROL,
        impaired=False,
        wire="swarm",
    )
    """States of drones of one process, for the drones of others. These draw the losses."""
    framed_state: Topic = Topic(
        21, "framed", State, 100, 0.25, 0, MessageClass.CONTROL, wire="frame"
    )
    """Interest of a law in the state of a drone of another process. It comes in `airspace`."""
    link: Topic = Topic(
        15,
        "link",
        LinkStatus,
        10,
        0.5,
        0,
        MessageClass.CONTROL,
        latched=True,
        impaired=False,
        of_body=True,
    )
    """State of the radio link."""


DRONE_TOPICS = DroneTopics()


@dataclass(frozen=True, slots=True)
class MessageTopics:
    """Topics of messages that are sent to given receivers: to drones and operators along an edge,
    or to a process.
    """

    cut: Topic = Topic(
        10,
        "cut",
        None,
        0,
        NEVER_STALE,
        0,
        MessageClass.CONTROL,
        impaired=False,
        wire="edge",
    )
    """Cut of the motors, from a drone to its body in another process. It replaces the command."""
    wanted_states: Topic = Topic(
        13, "sought", None, 0, NEVER_STALE, 0, MessageClass.CONTROL, wire="edge"
    )
    """Request for missing states of other drones."""
    relayed_states: Topic = Topic(
        14, "hearsay", None, 0, NEVER_STALE, 0, MessageClass.CONTROL, wire="edge"
    )
    """States of other drones, as the sender received them."""
    rounds: Topic = Topic(
        16, "round", None, 0, NEVER_STALE, 0, MessageClass.ROUNDS, wire="edge"
    )
    """Messages of round algorithms."""
    heartbeat: Topic = Topic(
        17, "heartbeat", None, 4, 1.0, 0, MessageClass.CONTROL, wire="edge"
    )
    """Sign of life, with the state of the team."""
    roster: Topic = Topic(
        18, "roster", None, 0, NEVER_STALE, 0, MessageClass.RELIABLE, wire="edge"
    )
    """Messages about the composition of the team."""
    acknowledgement: Topic = Topic(
        19, "ack", None, 0, NEVER_STALE, 0, MessageClass.ROUNDS, wire="edge"
    )
    """Acknowledgements of reliable messages."""
    request: Topic = Topic(
        24,
        "request",
        None,
        0,
        NEVER_STALE,
        0,
        MessageClass.ROUNDS,
        impaired=False,
        wire="edge",
    )
    """Commands of operators."""
    answer: Topic = Topic(
        25,
        "answer",
        None,
        0,
        NEVER_STALE,
        0,
        MessageClass.ROUNDS,
        impaired=False,
        wire="edge",
    )
    """Answers to commands."""
    emergency_stop: Topic = Topic(
        26,
        "estop",
        None,
        0,
        NEVER_STALE,
        0,
        MessageClass.ESTOP,
        impaired=False,
        wire="edge",
    )
    """Emergency stop, or its end."""
    hello: Topic = Topic(
        32,
        "hello",
        None,
        1,
        NEVER_STALE,
        0,
        MessageClass.ROUNDS,
        impaired=False,
        wire="process",
    )
    """Description of a process."""
    clock: Topic = Topic(
        33,
        "clock",
        None,
        1,
        NEVER_STALE,
        0,
        MessageClass.ROUNDS,
        impaired=False,
        wire="process",
    )
    """Times, to estimate the offset of clocks."""


MESSAGE_TOPICS = MessageTopics()

ALL_TOPICS: tuple[Topic, ...] = tuple(
    sorted(
        (
            getattr(table, field.name)
            for table in (DRONE_TOPICS, MESSAGE_TOPICS)
            for field in fields(table)
        ),
        key=lambda topic: topic.number,
    )
)
"""All topics, by number. A number that is missing is free."""
TOPIC_BY_NAME = {topic.name: topic for topic in ALL_TOPICS}
"""Topics by name."""
TOPIC_BY_NUMBER = {topic.number: topic for topic in ALL_TOPICS}
"""Topics by number."""
OBSERVABLE_TOPICS = tuple(
    topic.name for topic in ALL_TOPICS if topic.wire == "interest"
)
"""Names of the topics that an observer may ask for."""
REQUESTED_TOPICS = tuple(
    topic.name for topic in ALL_TOPICS if topic.wire in ("interest", "swarm", "frame")
)
"""Names of the topics that another process may ask for."""
