"""A client of Foxglove's WebSocket protocol without its SDK: frames by hand, content by the schemas of the server.

Source: https://github.com/foxglove/foxglove-sdk, the specification of the protocol.
"""

import asyncio
import base64
import contextlib
import json
import struct
from collections.abc import AsyncIterator
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.json_format import MessageToDict
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from ros2_decoders import fields
from system.agents import until
from websockets.asyncio.client import connect

SUBPROTOCOL = "foxglove.sdk.v1"
MESSAGE_DATA = 1
SERVICE_RESPONSE = 3
SERVICE_REQUEST = 2


class FoxgloveClient:
    """What one client was told, by topic; and its calls of services."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.heard: dict[str, list[dict[str, Any]]] = {}
        self._decoders: dict[int, Any] = {}
        self._topics: dict[int, str] = {}
        self._calls: dict[int, asyncio.Future[dict[str, Any]]] = {}

    async def read(self) -> None:
        async for message in self.socket:
            if isinstance(message, bytes):
                self._take(message)
            else:
                self._told(json.loads(message))

    def _told(self, told: dict[str, Any]) -> None:
        match told["op"]:
            case "serverInfo":
                self.info = told
            case "advertise":
                self.channels |= {one["topic"]: one for one in told["channels"]}
            case "advertiseServices":
                self.services |= {one["name"]: one for one in told["services"]}
            case "serviceCallFailure":
                failed = self._calls.pop(told["callId"])
                failed.set_exception(RuntimeError(told["message"]))

    def _take(self, message: bytes) -> None:
        if message[0] == MESSAGE_DATA:
            number, _ = struct.unpack_from("<IQ", message, 1)
            found = self._decoders[number](message[13:])
            self.heard.setdefault(self._topics[number], []).append(found)
        elif message[0] == SERVICE_RESPONSE:
            _, call, length = struct.unpack_from("<III", message, 1)
            assert message[13 : 13 + length] == b"json"
            self._calls.pop(call).set_result(json.loads(message[13 + length :]))

    async def subscribe(self, *topics: str) -> None:
        wanted = []
        for topic in topics:
            channel = self.channels[topic]
            number = len(self._topics) + 1
            self._topics[number] = topic
            self._decoders[number] = decoder(channel)
            wanted.append({"id": number, "channelId": channel["id"]})
        await self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    async def call(self, name: str, seconds: float = 60.0, **request: Any) -> Any:
        """The answer of a service; raises RuntimeError if it is refused."""
        number = len(self._calls) + 1
        answer = self._calls[number] = asyncio.get_running_loop().create_future()
        head = struct.pack(
            "<BIII", SERVICE_REQUEST, self.services[name]["id"], number, len(b"json")
        )
        await self.socket.send(head + b"json" + json.dumps(request).encode())
        return await asyncio.wait_for(answer, seconds)

    async def until(self, condition: Any, seconds: float = 20.0) -> None:
        await until(condition, seconds, lambda: str(self.heard.keys()))

    def last(self, topic: str) -> dict[str, Any]:
        return self.heard[topic][-1]


@contextlib.asynccontextmanager
async def foxglove_client(
    port: int, channels: int = 1
) -> AsyncIterator[FoxgloveClient]:
    """A connected client, as soon as it knows of this number of channels."""
    async with connect(
        f"ws://127.0.0.1:{port}", subprotocols=[SUBPROTOCOL], max_size=None
    ) as socket:
        assert socket.subprotocol == SUBPROTOCOL
        client = FoxgloveClient(socket)
        reading = asyncio.create_task(client.read())
        try:
            await client.until(lambda: len(client.channels) >= channels)
            yield client
        finally:
            reading.cancel()
            await asyncio.wait([reading])


def decoder(channel: dict[str, Any]) -> Any:
    """A function that returns the fields of a message of this channel."""
    if channel["encoding"] == "protobuf":
        return _protobuf_decoder(channel)
    assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
    schema = Schema(1, channel["schema"].encode(), "ros2msg", channel["schemaName"])
    decode = DecoderFactory().decoder_for("cdr", schema)
    return lambda data: fields(decode(data))


def _protobuf_decoder(channel: dict[str, Any]) -> Any:
    files = descriptor_pb2.FileDescriptorSet()
    files.ParseFromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(
        pool.FindMessageTypeByName(channel["schemaName"])
    )

    def decode(data: bytes) -> dict[str, Any]:
        message = kind()
        message.ParseFromString(data)
        return MessageToDict(message, preserving_proto_field_name=True)

    return decode
