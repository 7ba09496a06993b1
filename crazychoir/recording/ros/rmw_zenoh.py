"""Keys, tokens and attachments that rmw_zenoh of ROS 2 expects of a node.

Experimental: tested against the written specification and independent decoders, never against ROS
itself.

    data   <domain>/<topic>/<package>::<msg or srv>::dds_::<Type>_/<hash>
    node   @ros2_lv/<domain>/<session>/0/0/NN/%/%/<name>
    endpoint @ros2_lv/<domain>/<session>/0/<number>/<kind>/%/%/<name>/<topic>/<type>/<hash>/<qos>

Every / within a part is written as %.
Source: the design document of rmw_zenoh, as of Jazzy to Kilted.
"""

import struct
from dataclasses import dataclass
from enum import StrEnum

from crazychoir.errors import ConfigError

TYPE_HASHES = {
    "geometry_msgs/msg/PoseStamped": "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    "geometry_msgs/msg/TwistStamped": "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    "nav_msgs/msg/Odometry": "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "nav_msgs/msg/Path": "1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b",
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_srvs/srv/Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "visualization_msgs/msg/MarkerArray": "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
}
"""Hashes of the definitions of messages and services, in ROS 2 Jazzy."""


class EndpointKind(StrEnum):
    """What an endpoint of a node does, as tokens write it."""

    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"


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
    """Bytes of the id of an endpoint or client."""


RMW_ZENOH = RmwZenohParts()


_ATTACHMENT_LAYOUT = struct.Struct("<qqB16s")
_ROS2_INSTALL_HINT = "pip install 'crazychoir[ros2]'."


def node_token(domain: int, session: str, name: str) -> str:
    """Return the token that announces a node."""
    empty = RMW_ZENOH.empty_part
    return f"@ros2_lv/{domain}/{session}/{RMW_ZENOH.node_numbers}/NN/{empty}/{empty}/{name}"


@dataclass(frozen=True)
class Endpoint:
    """One topic that a node publishes or reads, or one service that it offers."""

    domain: int
    """Number of the ROS domain."""
    session: str
    """Id of the Zenoh session, hexadecimal."""
    name: str
    """Name of the node."""
    number: int
    """Number of the endpoint in the session, from 1."""
    topic: str
    """The topic, or the name of the service."""
    type: str
    """Type of its messages, or of the service, such as "nav_msgs/msg/Path"."""
    kind: EndpointKind = EndpointKind.PUBLISHER
    """What it does."""

    @property
    def _wire_type(self) -> str:
        package, folder, name = self.type.split("/")
        return f"{package}::{folder}::dds_::{name}_/RIHS01_{TYPE_HASHES[self.type]}"

    @property
    def key(self) -> str:
        """Key of its messages or requests."""
        return f"{self.domain}/{self.topic.strip('/')}/{self._wire_type}"

    @property
    def token(self) -> str:
        """Token that announces this endpoint."""
        topic = self.topic.replace("/", "%")
        empty = RMW_ZENOH.empty_part
        own = f"{empty}/{empty}/{self.name}/{topic}/{self._wire_type}/{RMW_ZENOH.quality_of_service}"
        return (
            f"@ros2_lv/{self.domain}/{self.session}/0/{self.number}/{self.kind}/{own}"
        )

    @property
    def gid(self) -> bytes:
        """(16,) Id of the endpoint in its messages.

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


def reply_attachment(request: bytes, born_ns: int) -> bytes:
    """Return the attachment of the answer to a request: its number and the id of its client.

    request: attachment of the request
    born_ns: ns since 1970 at which the answer was born
    Raises struct.error for an attachment of another form.
    """
    number, _, size, gid = _ATTACHMENT_LAYOUT.unpack(request)
    return _ATTACHMENT_LAYOUT.pack(number, born_ns, size, gid)
