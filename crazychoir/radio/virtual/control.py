"""Ask virtual Crazyflies for the truth, and set their faults: for tests and for an operator."""

import json
import socket
from dataclasses import dataclass
from typing import Any

from crazychoir.errors import Refused


@dataclass(frozen=True, slots=True)
class QuestionLimits:
    """Sizes and attempts of a question to the server."""

    receive_size: int = 1 << 16
    """Bytes of the buffer for a received datagram."""
    datagram_size: int = 65_507
    """Bytes of the largest datagram of UDP."""
    attempts: int = 3
    """Times that a question is sent."""


QUESTION_LIMITS = QuestionLimits()


def ask_server(
    question: dict[str, Any],
    host: str = "127.0.0.1",
    port: int = 19849,
    deadline: float = 1.0,
) -> dict[str, Any]:
    """Return the answer of the server with cameras at this port.

    If one datagram cannot hold all drones, the answer comes in parts; each is asked for after the
    last: {"after": 7}.

    question: {"ask": "state"}, {"ask": "faults"} or {"faults": {"3": {"loss": 0.3}, "all":
      {"delay": 0.02}}}
    deadline: s for each part
    Raises Refused if a part has no answer in time, or the question is not allowed.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        door.settimeout(deadline / QUESTION_LIMITS.attempts)
        door.connect((host, port))
        answer = _ask_part(door, question, f"virtual Crazyflies at {host}:{port}")
        more = answer.pop("more", False)
        while more:
            last = int(list(answer["drones"])[-1])
            part = _ask_part(
                door,
                {**question, "after": last},
                f"virtual Crazyflies at {host}:{port}",
            )
            answer["drones"] |= part["drones"]
            more = part.get("more", False) and bool(part["drones"])
        return answer


def _ask_part(
    door: socket.socket, question: dict[str, Any], server: str
) -> dict[str, Any]:
    """Return one part of an answer.

    An answer may arrive after its question was sent again, so only the answer to this question
    counts.
    """
    asked = json.dumps(question).encode()
    if len(asked) > QUESTION_LIMITS.datagram_size:
        do = "Ask for fewer drones at once, or name them as 3,4 with one table for all."
        raise Refused(
            server,
            f"a question of {len(asked)} bytes; a datagram has {QUESTION_LIMITS.datagram_size} at most. {do}",
        )
    for _ in range(QUESTION_LIMITS.attempts):
        try:
            door.send(asked)
            answer = _receive_answer(door)
            while (
                answer.get("after") != question.get("after") and "error" not in answer
            ):
                answer = _receive_answer(door)
        except OSError:
            continue
        except ValueError as error:
            raise Refused(
                server,
                f"the answer is not JSON: {error}. Is it `crazychoir virtual`?",
            ) from error
        if "error" in answer:
            raise Refused(server, answer["error"])
        answer.pop("after", None)
        return answer
    raise Refused(
        server,
        "no answer. Start `crazychoir virtual`, or give its first port with --port.",
    )


def _receive_answer(door: socket.socket) -> dict[str, Any]:
    answer = json.loads(door.recv(QUESTION_LIMITS.receive_size))
    if not isinstance(answer, dict):
        raise ValueError("no object")
    return answer
