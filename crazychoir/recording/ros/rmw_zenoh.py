"""Keys, tokens and attachments that rmw_zenoh of ROS 2 expects of a publisher.

Experimental: tested against the written specification and independent decoders, never against ROS
itself.

    data   <domain>/<topic>/<package>::msg::dds_::<Type>_/<hash>
    node   @ros2_lv/<domain>/<session>/0/0/NN/%/%/<name>
    publisher @ros2_lv/<domain>/<session>/0/<number>/MP/%/%/<name>/<topic>/<type>/<hash>/<qos>

Every / within a part is written as %.
Source: the design document of rmw_zenoh, as of Jazzy to Kilted.
"""

import struct
from dataclasses import dataclass

from crazychoir.errors import ConfigError

MESSAGE_HASHES = {
    "geometry_msgs/PoseStamped": "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    "nav_msgs/Path": "1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b",
    "visualization_msgs/MarkerArray": "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
    "tf2_msgs/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
}
"""Hashes of the definitions of the published messages, in ROS 2 Jazzy."""


@dataclass(frozen=True, slots=True)
class RmwZenohParts:
    """Fixed parts of the tokens and attachments that rmw_zenoh expects."""

    quality_of_service: str = "::,10:,:,:,,"
    """Quality of service: reliable, volatile, the last 10 messages, no deadlines."""
    node_numbers: str = "0/0"
    """Numbers in a node's token."""
    empty_part: str = "%"
    """An empty part of a token."""
    gid_size: int = 16
    """Bytes of a publisher's id."""


RMW_ZENOH = RmwZenohParts()


_ATTACHMENT_LAYOUT = struct.Struct("<qqB16s")
_ROS2_INSTALL_HINT = "pip install 'crazychoir[ros2]'."


def node_token(domain: int, session: str, name: str) -> str:
    """Return the token that announces a node."""
    empty = RMW_ZENOH.empty_part
    return f"@ros2_lv/{domain}/{session}/{RMW_ZENOH.node_numbers}/NN/{empty}/{empty}/{name}"


@dataclass(frozen=True)
class Publisher:
    """One topic of a node."""

    domain: int
    """Number of the ROS domain."""
    session: str
    """Id of the Zenoh session, hexadecimal."""
    name: str
    """Name of the node."""
    number: int
    """Number of the publisher in the session, from 1."""
    topic: str
    """The topic."""
    type: str
    """Type of its messages, such as "nav_msgs/Path"."""

    @property
    def _kind(self) -> str:
        package, _, kind = self.type.partition("/")
        return f"{package}::msg::dds_::{kind}_/RIHS01_{MESSAGE_HASHES[self.type]}"

    @property
    def key(self) -> str:
        """Key of its messages."""
        return f"{self.domain}/{self.topic.strip('/')}/{self._kind}"

    @property
    def token(self) -> str:
        """Token that announces this publisher."""
        topic = self.topic.replace("/", "%")
        empty = RMW_ZENOH.empty_part
        own = f"{empty}/{empty}/{self.name}/{topic}/{self._kind}/{RMW_ZENOH.quality_of_service}"
        return f"@ros2_lv/{self.domain}/{self.session}/0/{self.number}/MP/{own}"

    @property
    def gid(self) -> bytes:
        """(16,) Id of the publisher in its messages.

        It is the XXH3-128 of the token, its lower half first, little-endian.
        Raises ConfigError if the package xxhash is missing.
        """
        try:
            import xxhash
        except ImportError as error:
            raise ConfigError(
                "crazychoir ros",
                "no package xxhash",
                "that of the extra ros2",
                _ROS2_INSTALL_HINT,
            ) from error
        number: int = xxhash.xxh3_128_intdigest(self.token.encode())
        return number.to_bytes(RMW_ZENOH.gid_size, "little")

    def attachment(self, number: int, born_ns: int) -> bytes:
        """Return the attachment of a message.

        number: number of the message, from 1
        born_ns: ns since 1970 at which the message was born
        """
        return _ATTACHMENT_LAYOUT.pack(number, born_ns, RMW_ZENOH.gid_size, self.gid)
