"""Convert a recording to a bag of ROS 2.

A bag is a folder with an MCAP file of standard messages, and metadata.yaml.
"""

import contextlib
import json
import shutil
from dataclasses import dataclass, field
from pathlib import Path

from mcap.well_known import MessageEncoding, SchemaEncoding

from crazychoir.bus.network.hello import PACKAGE_VERSION
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.file import LARGEST_CHUNK
from crazychoir.recording.mcap.sequence import read_messages
from crazychoir.recording.mcap.writer import McapWriter, Timed
from crazychoir.recording.ros.ros import RosMessage, to_ros_messages

METADATA_FILE = "metadata.yaml"
BAG_VERSION = 5
"""Version of the format of metadata.yaml: that of Humble, which later releases read too."""


@dataclass
class BagTopic:
    """A topic of a bag."""

    id: int
    """Its number in the file."""
    type: str
    """Type of its messages."""
    count: int = 0
    """Count of its messages."""


@dataclass
class Bag:
    """A new bag in a folder.

    Raises ConfigError if the folder exists already or cannot be made.
    """

    folder: Path
    """The folder."""
    channels: dict[str, BagTopic] = field(default_factory=dict)
    """Topics by name."""
    first_ns: int = 0
    """Time of arrival of the first message, ns."""
    last_ns: int = 0
    """Time of arrival of the last message, ns."""
    whole: bool = False
    """True after the bag is closed and completely written."""

    def __post_init__(self) -> None:
        made = False
        try:
            self.folder.mkdir(parents=True)
            made = True
            self._file = self.path.open("xb")
        except OSError as error:
            if made:
                self.folder.rmdir()
            do = "A bag is never written over: name another folder, or remove that one."
            raise ConfigError(
                "--rosbag2", str(self.folder), "a new folder", do, str(error.strerror)
            ) from error
        self._writer, self._schemas = McapWriter(), dict[str, int]()
        self._waiting: list[Timed] = []
        self._bytes = 0
        self._writer.begin("ros2", f"crazychoir {PACKAGE_VERSION}")

    @property
    def path(self) -> Path:
        """Path of its only file of messages."""
        return self.folder / f"{self.folder.name}_0.mcap"

    @property
    def count(self) -> int:
        """Count of its messages."""
        return sum(channel.count for channel in self.channels.values())

    def write(self, said: RosMessage, came_ns: int, born_ns: int) -> None:
        """Add a message."""
        channel = self.channels.get(said.topic) or self._open(said)
        self.first_ns = min(self.first_ns, came_ns) if self.count else came_ns
        self.last_ns = max(self.last_ns, came_ns)
        channel.count += 1
        self._waiting.append((channel.id, came_ns, born_ns, said.data))
        self._bytes += len(said.data)
        if self._bytes > LARGEST_CHUNK:
            self._flush()

    def close(self) -> None:
        """Write the remaining messages, the index, and the metadata."""
        self._flush()
        self._writer.finish()
        self._file.write(self._writer.take())
        self._file.close()
        (self.folder / METADATA_FILE).write_text(self._metadata(), encoding="utf-8")
        self.whole = True

    def discard(self) -> None:
        """Remove the folder."""
        with contextlib.suppress(
            OSError
        ):  # the disk may have no room for buffered bytes
            self._file.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _open(self, said: RosMessage) -> BagTopic:
        if said.type not in self._schemas:
            self._schemas[said.type] = self._writer.schema(
                said.type, SchemaEncoding.ROS2, said.schema
            )
        told = {"offered_qos_profiles": ""}
        number = self._writer.channel(
            said.topic, MessageEncoding.CDR, self._schemas[said.type], told
        )
        channel = self.channels[said.topic] = BagTopic(number, said.type)
        return channel

    def _flush(self) -> None:
        if self._waiting:
            self._writer.chunk(self._waiting)
            self._waiting = []
            self._bytes = 0
            self._file.write(self._writer.take())

    def _metadata(self) -> str:
        """Return the metadata as JSON, which is valid YAML."""
        times = {
            "duration": {"nanoseconds": self.last_ns - self.first_ns},
            "starting_time": {"nanoseconds_since_epoch": self.first_ns},
            "message_count": self.count,
        }
        form = {"serialization_format": "cdr", "offered_qos_profiles": ""}
        topics = [
            {
                "topic_metadata": {"name": name, "type": channel.type, **form},
                "message_count": channel.count,
            }
            for name, channel in self.channels.items()
        ]
        about = {
            "version": BAG_VERSION,
            "storage_identifier": "mcap",
            **times,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self.path.name],
            "files": [{"path": self.path.name, **times}],
        }
        return json.dumps({"rosbag2_bagfile_information": about}, indent=2) + "\n"


def convert(path: Path, folder: Path) -> Bag:
    """Convert a recording to a bag.

    Raises ConfigError if the file is no recording or the disk is full; then no folder is left.
    """
    truths = frozenset(
        message.source.drone
        for message in read_messages(path, (DRONE_TOPICS.truth.name,))
    )
    bag = Bag(folder)
    try:
        for message in read_messages(path):
            for said in to_ros_messages(message, truths):
                bag.write(said, message.came_ns, message.born_ns)
        bag.close()
    except OSError as error:
        do = "Make room, or name a folder on another disk."
        raise ConfigError(
            "--rosbag2",
            str(folder),
            "a folder that can be written",
            do,
            str(error.strerror),
        ) from error
    finally:
        if not bag.whole:
            bag.discard()
    return bag
