"""A node of ROS 2 in the form of rmw_zenoh: its tokens, its keys and its messages."""

from typing import Protocol

from crazychoir.recording.ros.rmw_zenoh import Endpoint, EndpointKind, node_token


class Outside(Protocol):
    """The part of a session with ROS that a node needs to publish."""

    @property
    def id(self) -> str:
        """Id of the session."""
        ...

    def token(self, key: str) -> None:
        """Declare a liveliness token until the end of the session."""
        ...

    def put(self, key: str, data: bytes, attachment: bytes) -> None:
        """Send data to all subscribers of a key."""
        ...


class RosNode:
    """Announces endpoints, and publishes messages.

    outside: session with the ROS network
    domain: ROS_DOMAIN_ID
    name: name of the node
    """

    def __init__(self, outside: Outside, domain: int, name: str) -> None:
        self._outside = outside
        self._domain = domain
        self._name = name
        self._count = 0
        self._publishers: dict[str, Endpoint] = {}
        self._said: dict[str, int] = {}
        outside.token(node_token(domain, outside.id, name))

    def announce(self, topic: str, kind: str, role: EndpointKind) -> Endpoint:
        """Return a new endpoint of this node that the ROS network has been told of.

        topic: topic, or name of a service
        kind: type of its messages, or of the service
        role: what the node does with it
        """
        self._count += 1
        endpoint = Endpoint(
            self._domain, self._outside.id, self._name, self._count, topic, kind, role
        )
        self._outside.token(endpoint.token)
        return endpoint

    def publish_on(self, topic: str, kind: str) -> None:
        """Announce that this node publishes a topic."""
        self._publishers[topic] = self.announce(topic, kind, EndpointKind.PUBLISHER)
        self._said[topic] = 0

    def put(self, topic: str, data: bytes, now_ns: int) -> None:
        """Publish a message.

        topic: a topic of `publish_on`
        now_ns: ns since 1970
        """
        self._said[topic] += 1
        publisher = self._publishers[topic]
        self._outside.put(
            publisher.key, data, publisher.attachment(self._said[topic], now_ns)
        )
