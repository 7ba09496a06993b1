"""The table of topics in bus/README.md, from bus/topics.py."""

import math

from crazychoir.bus import topics
from reference.markdown import attribute_docs
from reference.markdown import table as markdown_table

READERS = {
    "interest": "all that ask",
    "edge": "the addressed port",
    "swarm": "drones that ask",
    "frame": "drones that ask, in frames of `airspace`",
    "process": "a process",
}
"""Receivers of a message, by the wire of its topic."""


def table() -> str:
    """Return a row for each topic: what it carries, how often, and how it travels."""
    docs = {
        getattr(group, field).name: text
        for group in (topics.DRONE_TOPICS, topics.MESSAGE_TOPICS)
        for field, text in attribute_docs(type(group)).items()
    }
    rows = []
    for topic in topics.ALL_TOPICS:
        stale = "never" if math.isinf(topic.max_age) else f"{topic.max_age:g}"
        notes = [
            text
            for text, is_true in (
                ("latched", topic.latched),
                ("simulated network", topic.impaired),
                (f"public at {topic.public:g} Hz", topic.public > 0),
            )
            if is_true
        ]
        rows.append(
            [
                f"`{topic.name}`",
                docs[topic.name],
                topic.allowed,
                f"{topic.rate:g}" if topic.rate else "",
                stale,
                topic.klass.name.lower(),
                READERS[topic.wire],
                ", ".join(notes),
            ]
        )
    head = (
        "topic",
        "carries",
        "type",
        "Hz",
        "stale after, s",
        "class",
        "receivers",
        "notes",
    )
    return markdown_table(head, rows)
