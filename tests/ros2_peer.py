"""A program of ROS 2 as zenoh-ros2-sdk plays it: an implementation of rmw_zenoh that is independent of ours."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import zenoh
from ports import free_ports
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2Subscriber
from zenoh_ros2_sdk.discovery import get_topic_names_and_types
from zenoh_ros2_sdk.message_registry import get_registry
from zenoh_ros2_sdk.session import ZenohSession

STORE = get_typestore(Stores.ROS2_JAZZY)
TRIGGER = "std_srvs/srv/Trigger"
NO_FIELDS = "uint8 structure_needs_at_least_one_member"


@contextlib.contextmanager
def ros_router() -> Iterator[int]:
    """A Zenoh router in the place of rmw_zenohd; its port."""
    port = free_ports([0])
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config):
        yield port


class RosPeer:
    """Subscribes, publishes and calls services; messages come as rosbags decodes them."""

    def __init__(self, port: int) -> None:
        self.where = {"router_ip": "127.0.0.1", "router_port": port, "domain_id": 0}
        self.heard: dict[str, list[Any]] = {}
        self._opened: list[Any] = []

    def subscribe(self, topic: str, kind: str) -> None:
        heard = self.heard.setdefault(topic, [])
        self._opened.append(ROS2Subscriber(topic, kind, heard.append, **self.where))

    def publisher(self, topic: str, kind: str) -> Any:
        self._opened.append(ROS2Publisher(topic, kind, **self.where))
        return self._opened[-1]

    def trigger(self, service: str, seconds: float = 60.0) -> Any:
        """The answer of a std_srvs/srv/Trigger; None if there is none."""
        client = ROS2ServiceClient(
            service,
            TRIGGER,
            NO_FIELDS,
            "bool success\nstring message",
            timeout=seconds,
            **self.where,
        )
        self._opened.append(client)
        return client.call(structure_needs_at_least_one_member=0)

    def topics(self) -> dict[str, list[str]]:
        """Types by topic, as `ros2 topic list -t` shows them."""
        return dict(get_topic_names_and_types(**self.where, timeout=5.0))

    def close(self) -> None:
        for one in self._opened:
            one.close()


@contextlib.contextmanager
def ros_peer(port: int, folder: Path) -> Iterator[RosPeer]:
    """A peer at a router; folder: gets the definitions, because nothing is downloaded."""
    for name in STORE.types:
        package, _, kind = name.split("/")
        file = folder / package / "msg" / f"{kind}.msg"
        file.parent.mkdir(parents=True, exist_ok=True)
        text, _ = STORE.generate_msgdef(name, ros_version=2)
        file.write_text(text.split("=" * 80)[0])
    ZenohSession._instance = None
    get_registry().messages_dir = folder
    get_registry()._loaded_types.clear()
    peer = RosPeer(port)
    session = ZenohSession.get_instance("127.0.0.1", port)
    try:
        yield peer
    finally:
        peer.close()
        session.session.close()
        ZenohSession._instance = None


def made(kind: str, **fields: Any) -> Any:
    """A message of this type."""
    return STORE.types[kind](**fields)
