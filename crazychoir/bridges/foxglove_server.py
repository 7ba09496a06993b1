"""The WebSocket server for Foxglove. This is the only module that imports foxglove.

The server runs in threads of the SDK. A slow client loses its oldest messages, and delays no other.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence

import foxglove
from foxglove import Channel, Context, MessageSchema, Schema, Service, ServiceSchema
from foxglove.channels import FrameTransformsChannel, LogChannel, SceneUpdateChannel
from foxglove.messages import (
    Color,
    Duration,
    FrameTransform,
    FrameTransforms,
    LinePrimitive,
    LinePrimitiveLineType,
    Log,
    LogLevel,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneEntityDeletion,
    SceneEntityDeletionType,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    Timestamp,
    Vector3,
)
from foxglove.websocket import Capability

from crazychoir.bridges.operator_services import OPERATOR_SERVICES, OperatorService
from crazychoir.dashboard.event_log import LogLine
from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.messages import RecordedForm
from crazychoir.recording.ros.scene import (
    WORLD_FRAME,
    SceneShape,
    ShapeKind,
    drone_frame,
)
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import State

LOOPBACK_HOST = "127.0.0.1"
"""The only address that is served: the protocol has no password."""
JSON_ENCODING = "json"
KEY_FIELD = {"key": {"type": "string", "description": "The key of the commands."}}
"""JSON schema of the field with the key of the commands."""
LOG_LEVELS = {
    "info": LogLevel.Info,
    "warning": LogLevel.Warning,
    "error": LogLevel.Error,
}
RECEIPT_SCHEMA = {
    "type": "object",
    "properties": {"done": {"type": "boolean"}, "answers": {"type": "object"}},
}
"""JSON schema of the answer of a service."""

Places = Mapping[int, tuple[State, int]]
"""State of each drone by id, and the time of its birth in ns since 1970."""
AnswerCall = Callable[[str, bytes], bytes]
"""Callable that gets the name of a service and a request, and returns the answer.

It is called in a thread of the request, and may wait. It raises an error to refuse.
"""


class MessageSeries:
    """The messages of one topic in the form of a recording: ROS 2 messages in CDR."""

    def __init__(self, topic: str, form: RecordedForm, context: Context) -> None:
        schema = Schema(name=form.type, encoding="ros2msg", data=form.schema.encode())
        self._channel = Channel(
            topic, schema=schema, message_encoding="cdr", context=context
        )

    @property
    def is_watched(self) -> bool:
        """Whether a client reads it."""
        watched: bool = self._channel.has_sinks()
        return watched

    def send(self, data: bytes, now_ns: int) -> None:
        """Send a message to the clients that read it."""
        self._channel.log(data, log_time=now_ns)


class FoxgloveServer:
    """Serves topics and services to Foxglove, on this machine alone.

    name: name of the swarm
    port: port to listen at, 0 for a free one
    answer: answers the calls of services; None to offer no services
    Raises ConfigError if the port is taken.
    """

    def __init__(self, name: str, port: int, answer: AnswerCall | None) -> None:
        self._context = Context()
        self._transforms = FrameTransformsChannel("/tf", context=self._context)
        self._scene = SceneUpdateChannel("/scene", context=self._context)
        self._log = LogChannel("/log", context=self._context)
        services = [] if answer is None else [*_make_services(answer)]
        try:
            self._server = foxglove.start_server(
                name=f"crazychoir {name}",
                host=LOOPBACK_HOST,
                port=port,
                capabilities=[Capability.Services] if services else [],
                supported_encodings=[JSON_ENCODING],
                services=services,
                context=self._context,
            )
        except Exception as error:
            raise ConfigError(
                "--port", str(port), "a free port of this machine", problem=str(error)
            ) from error

    @property
    def port(self) -> int:
        """Port at which it listens."""
        port: int = self._server.port
        return port

    @property
    def shows_scene(self) -> bool:
        """Whether a client reads the scene."""
        watched: bool = self._scene.has_sinks()
        return watched

    def series(self, topic: str, form: RecordedForm) -> MessageSeries:
        """Return a new topic for messages of a form."""
        return MessageSeries(topic, form, self._context)

    def send_transforms(self, places: Places, now_ns: int) -> None:
        """Send the transforms from the world to the drones.

        places: the newest state of each drone
        now_ns: ns since 1970
        """
        transforms = [_transform(i, *place) for i, place in sorted(places.items())]
        self._transforms.log(FrameTransforms(transforms=transforms), log_time=now_ns)

    def send_scene(self, shapes: Iterable[SceneShape], now_ns: int) -> None:
        """Send the whole scene; shapes of earlier scenes disappear.

        now_ns: ns since 1970
        """
        born = _timestamp(now_ns)
        update = SceneUpdate(
            deletions=[
                SceneEntityDeletion(timestamp=born, type=SceneEntityDeletionType.All)
            ],
            entities=[_entity(shape, born) for shape in shapes],
        )
        self._scene.log(update, log_time=now_ns)

    def send_log(self, line: LogLine, now_ns: int) -> None:
        """Send a line of the log.

        now_ns: ns since 1970
        """
        name = "swarm" if line.drone is None else f"drone {line.drone}"
        self._log.log(
            Log(
                timestamp=_timestamp(now_ns),
                level=LOG_LEVELS[line.level],
                message=line.text,
                name=name,
            ),
            log_time=now_ns,
        )

    def close(self) -> None:
        """Close all connections, and end."""
        self._server.stop()


def _make_services(answer: AnswerCall) -> list[Service]:
    receipt = _json_schema("Receipt", RECEIPT_SCHEMA)

    def handle(request: foxglove.ServiceRequest) -> bytes:
        return answer(request.service_name, request.payload)

    return [
        Service(
            service.path,
            schema=ServiceSchema(
                service.name,
                request=_json_schema(service.name, _request_schema(service)),
                response=receipt,
            ),
            handler=handle,
        )
        for service in OPERATOR_SERVICES
    ]


def _request_schema(service: OperatorService) -> dict[str, object]:
    return {
        "type": "object",
        "properties": {**KEY_FIELD, **service.fields},
        "required": [*KEY_FIELD],
    }


def _json_schema(name: str, content: Mapping[str, object]) -> MessageSchema:
    schema = Schema(name=name, encoding="jsonschema", data=json.dumps(content).encode())
    return MessageSchema(encoding=JSON_ENCODING, schema=schema)


def _timestamp(now_ns: int) -> Timestamp:
    seconds, rest = divmod(now_ns, NS_PER_SECOND)
    return Timestamp(sec=seconds, nsec=rest)


def _transform(i: int, state: State, born_ns: int) -> FrameTransform:
    return FrameTransform(
        timestamp=_timestamp(born_ns),
        parent_frame_id=WORLD_FRAME,
        child_frame_id=drone_frame(i),
        translation=_vector(state.p.tolist()),
        rotation=_quaternion(state.q.tolist()),
    )


def _vector(x: Sequence[float]) -> Vector3:
    return Vector3(x=x[0], y=x[1], z=x[2])


def _quaternion(q: Sequence[float]) -> Quaternion:
    return Quaternion(x=q[0], y=q[1], z=q[2], w=q[3])


def _point(x: Sequence[float]) -> Point3:
    return Point3(x=x[0], y=x[1], z=x[2])


def _entity(shape: SceneShape, born: Timestamp) -> SceneEntity:
    red, green, blue, opacity = shape.color
    color = Color(r=red, g=green, b=blue, a=opacity)
    points = shape.points.tolist()
    balls: list[SpherePrimitive] = []
    lines: list[LinePrimitive] = []
    texts: list[TextPrimitive] = []
    match shape.kind:
        case ShapeKind.SPHERE:
            size = _vector(3 * [shape.size])
            balls = [
                SpherePrimitive(pose=_level_pose(p), size=size, color=color)
                for p in points
            ]
        case ShapeKind.TEXT:
            texts = [
                TextPrimitive(
                    pose=_level_pose(points[0]),
                    billboard=True,
                    font_size=shape.size,
                    color=color,
                    text=shape.text,
                )
            ]
        case kind:
            through = kind == ShapeKind.LINE_STRIP
            lines = [
                LinePrimitive(
                    type=LinePrimitiveLineType.LineStrip
                    if through
                    else LinePrimitiveLineType.LineList,
                    pose=_level_pose([0.0, 0.0, 0.0]),
                    thickness=shape.size,
                    points=[_point(p) for p in points],
                    color=color,
                )
            ]
    return SceneEntity(
        timestamp=born,
        frame_id=shape.frame,
        id=shape.name,
        lifetime=Duration(sec=0),
        frame_locked=True,
        spheres=balls,
        lines=lines,
        texts=texts,
    )


def _level_pose(p: Sequence[float]) -> Pose:
    return Pose(position=_vector(p), orientation=_quaternion([0.0, 0.0, 0.0, 1.0]))
