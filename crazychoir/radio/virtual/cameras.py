"""Motion capture that sees all virtual drones, and a port for questions and faults."""

import asyncio
import contextlib
import json
import socket
from collections.abc import Callable
from typing import Any

import numpy as np

from crazychoir.bus.json_view import to_plain_values
from crazychoir.errors import CodecError, CrazyChoirError
from crazychoir.mocap.frames import FRAME_PROTOCOL, PoseFrame
from crazychoir.mocap.mounting import Mounting
from crazychoir.numerics.math3d import quaternion_of_yaw, quaternion_product
from crazychoir.radio.virtual.control import QUESTION_LIMITS
from crazychoir.radio.virtual.faults import Faults
from crazychoir.radio.virtual.port import Address, open_socket, receive_waiting
from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.types import Mat, Vec

LONGEST_ERROR = 4000
"""Most characters of an error."""
Question = dict[str, Any]
"""A question: a JSON object."""
Answer = Callable[[Question], Any]
"""Callback that answers a question."""


def observe_bodies(
    states: Mat,
    rows: dict[int, int],
    faults: dict[int, Faults],
    names: dict[int, str],
    mountings: dict[int, Mounting],
) -> dict[str, Any]:
    """Return the bodies as the cameras see them.

    By their faults, bodies are lost, displaced, turned or exchanged.

    states: states of all drones, world
    rows: row of each drone in `states`
    faults: faults of each drone
    names: name of each drone's body
    mountings: mounting of each drone's body
    Returns {name: (7,) p in m and q, body to world}.
    """
    bodies: dict[str, Any] = {}
    for i, name in names.items():
        fault = faults[i]
        other = int(fault.swap) if fault.swap >= 0.0 else i
        if not fault.pose_lost and len(bodies) < FRAME_PROTOCOL.most_bodies:
            state = states[rows[other]]
            body = mountings[other].body(np.array([*state[:3], *state[6:10]]))
            bodies[name] = np.array(
                [
                    *(body[:3] + np.array(fault.offset)),
                    *_turn_about_z(body[3:7], fault.turned),
                ]
            )
    return bodies


def _turn_about_z(q: Vec, yaw: float) -> Any:
    """Return q (4,) of a body with its axes turned by `yaw` (rad) about its z axis.

    q q_z(yaw)
    """
    (a, b, c, d), (e, f, g, h) = q.tolist(), quaternion_of_yaw(yaw).tolist()
    return quaternion_product((a, b, c, d), (e, f, g, h)) if yaw else q


def _shorten_text(text: str) -> str:
    """Return a text, with its middle left out if it is too long: it may repeat a long question."""
    return (
        text
        if len(text) <= LONGEST_ERROR
        else f"{text[: LONGEST_ERROR // 2]} ... {text[-LONGEST_ERROR // 2 :]}"
    )


def _pack_answer(answer: Any) -> bytes:
    """Return an answer as a datagram; if it is too long, return an error that says so."""
    packed = json.dumps(to_plain_values(answer)).encode()
    if len(packed) <= QUESTION_LIMITS.datagram_size:
        return packed
    return json.dumps(
        {
            "error": f"the answer has {len(packed)} bytes; a datagram has {QUESTION_LIMITS.datagram_size} at most."
        }
    ).encode()


class CameraPort:
    """The port of the cameras.

    A client that has recently sent `FRAME_PROTOCOL.request` gets frames, and a client that sends
    JSON gets an answer.

    at: host and port
    answer: answers a question
    """

    def __init__(self, clock: Clock, at: Address, answer: Answer) -> None:
        self.clock = clock
        self.at = at
        self._answer = answer
        self.frames = 0
        """Frames sent so far."""
        self._watchers: dict[Address, int] = {}
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Open the port. Raises ConfigError if it is taken."""
        self._socket = open_socket(self.at)
        asyncio.get_running_loop().add_reader(self._socket, self._readable)

    def close(self) -> None:
        """Close the port."""
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
            self._socket = None

    @property
    def watched(self) -> bool:
        """Whether any client wants frames."""
        now_ns = self.clock.now_ns()
        self._watchers = {
            watcher: until
            for watcher, until in self._watchers.items()
            if until > now_ns
        }
        return bool(self._watchers)

    def show(self, time: float, bodies: dict[str, Any]) -> None:
        """Send a frame to all clients that want frames.

        time: s of the clock at which the bodies were there
        bodies: poses by name
        """
        self.frames += 1
        datagram = PoseFrame(self.frames, time, bodies).packed()
        for watcher in self._watchers:
            self._send(datagram, watcher)

    def _readable(self) -> None:
        for data, sender in receive_waiting(self._socket):
            if data == FRAME_PROTOCOL.request:
                self._watchers[sender] = self.clock.now_ns() + round(
                    FRAME_PROTOCOL.request_lifetime * NS_PER_SECOND
                )
            else:
                self._send(_pack_answer(self._answered(data)), sender)

    def _answered(self, data: bytes) -> Any:
        try:
            question = json.loads(data)
            if not isinstance(question, dict):
                raise CodecError(f"a question: {data[:40]!r}; allowed: a JSON object.")
            return self._answer(question)
        except (ValueError, RecursionError) as error:
            # A CrazyChoirError about a wrong value is a ValueError too.
            return {"error": _shorten_text(str(error))}
        except CrazyChoirError as error:
            return {"error": _shorten_text(str(error))}

    def _send(self, datagram: bytes, to: Address) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(datagram, to)
