"""To ask virtual Crazyflies for the truth, and to break them: for tests, and for an operator's hands."""

import json
import socket
from typing import Any

from crazychoir.errors import Refused

LONGEST = 65_000
TRIES = 3


def ask(question: dict[str, Any], host: str = "127.0.0.1", port: int = 19849, deadline: float = 1.0) -> dict[str, Any]:
    """The answer of the server whose cameras are at this port.

    question: {"ask": "state"}, {"ask": "faults"} or {"faults": {"3": {"loss": 0.3}, "all": {"delay": 0.02}}}.
    Raises Refused where nobody answers within `deadline` s, and for what is not allowed.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        door.settimeout(deadline / TRIES)
        door.connect((host, port))
        for _ in range(TRIES):
            try:
                door.send(json.dumps(question).encode())
                answer: dict[str, Any] = json.loads(door.recv(LONGEST))
            except OSError:
                continue
            if "error" in answer:
                raise Refused(f"virtual Crazyflies at {host}:{port}", answer["error"])
            return answer
    do = "Start `crazychoir virtual`, or name its first port by --port."
    raise Refused(f"virtual Crazyflies at {host}:{port}", f"nobody answers. {do}")
