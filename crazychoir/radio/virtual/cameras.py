"""Beside the drones: motion capture that sees all of them, and a door for questions and faults."""

import asyncio
import contextlib
import json
import socket
from collections.abc import Callable
from typing import Any

import numpy as np

from crazychoir.bus.json_view import plain
from crazychoir.errors import CodecError, CrazyChoirError
from crazychoir.mocap.frames import ASK, MOST, PATIENCE, Frame
from crazychoir.numerics.math3d import product, quaternion_of_yaw
from crazychoir.radio.virtual.control import LARGEST
from crazychoir.radio.virtual.faults import Faults
from crazychoir.radio.virtual.port import Address, opened, waiting
from crazychoir.runtime.clock import SECOND, Clock
from crazychoir.types import Mat, Vec

SHOWN = 4000
"""Characters of an error."""
Question = dict[str, Any]
Answer = Callable[[Question], Any]


def seen(
    states: Mat, rows: dict[int, int], faults: dict[int, Faults], names: dict[int, str]
) -> dict[str, Any]:
    """{name: (7,) p m, q} as the cameras take it: some bodies lost, elsewhere, turned, or taken for each other."""
    bodies: dict[str, Any] = {}
    for i, name in names.items():
        fault = faults[i]
        other = int(fault.swap) if fault.swap >= 0.0 else i
        if not fault.pose_lost and len(bodies) < MOST:
            state = states[rows[other]]
            bodies[name] = np.array(
                [
                    *(state[:3] + np.array(fault.offset)),
                    *_turned(state[6:10], fault.turned),
                ]
            )
    return bodies


def _turned(q: Vec, yaw: float) -> Any:
    """(4,) of a body whose axes are turned by `yaw` rad about its z: q q_z(yaw)."""
    (a, b, c, d), (e, f, g, h) = q.tolist(), quaternion_of_yaw(yaw).tolist()
    return product((a, b, c, d), (e, f, g, h)) if yaw else q


def _short(text: str) -> str:
    """A text that may repeat a long question."""
    return (
        text
        if len(text) <= SHOWN
        else f"{text[: SHOWN // 2]} ... {text[-SHOWN // 2 :]}"
    )


def _packed(answer: Any) -> bytes:
    """An answer as it travels; in place of one that no datagram holds, an error that says so."""
    packed = json.dumps(plain(answer)).encode()
    if len(packed) <= LARGEST:
        return packed
    return json.dumps(
        {
            "error": f"the answer has {len(packed)} bytes; a datagram has {LARGEST} at most."
        }
    ).encode()


class Cameras:
    """The port of the poses: who has sent ASK lately gets frames; who sends JSON gets an answer."""

    def __init__(self, clock: Clock, at: Address, answer: Answer) -> None:
        self.clock = clock
        self.at = at
        self._answer = answer
        self.frames = 0
        self._watchers: dict[Address, int] = {}
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Serve; ConfigError where the port is taken."""
        self._socket = opened(self.at)
        asyncio.get_running_loop().add_reader(self._socket, self._readable)

    def close(self) -> None:
        """No more."""
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
            self._socket = None

    @property
    def watched(self) -> bool:
        """Does anybody want frames?"""
        now_ns = self.clock.now_ns()
        self._watchers = {
            who: until for who, until in self._watchers.items() if until > now_ns
        }
        return bool(self._watchers)

    def show(self, time: float, bodies: dict[str, Any]) -> None:
        """One frame for all who look; time: s of the clock, when it was so."""
        self.frames += 1
        datagram = Frame(self.frames, time, bodies).packed()
        for who in self._watchers:
            self._send(datagram, who)

    def _readable(self) -> None:
        for data, sender in waiting(self._socket):
            if data == ASK:
                self._watchers[sender] = self.clock.now_ns() + round(PATIENCE * SECOND)
            else:
                self._send(_packed(self._answered(data)), sender)

    def _answered(self, data: bytes) -> Any:
        try:
            question = json.loads(data)
            if not isinstance(question, dict):
                raise CodecError(f"a question: {data[:40]!r}; allowed: a JSON object.")
            return self._answer(question)
        except (
            ValueError,
            RecursionError,
        ) as error:  # CrazyChoirErrors of wrong values are ValueErrors, too
            return {"error": _short(str(error))}
        except CrazyChoirError as error:
            return {"error": _short(str(error))}

    def _send(self, datagram: bytes, to: Address) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(datagram, to)
