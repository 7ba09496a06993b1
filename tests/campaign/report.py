"""What one seed comes to."""

import hashlib
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

LIGHTWEIGHT = "sim://"
"""World of a scenario in flight, unless another is asked for."""


@dataclass
class Report:
    """world: the uri of all drones in flight.

    injected: how often each fault was;  wrong: invariants that do not hold, sentence by sentence;  digest: of all
    that was computed, flown and said;  checks: invariants that were looked at.
    """

    seed: int
    kind: str
    world: str = LIGHTWEIGHT
    injected: dict[str, int] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)
    digest: str = ""
    checks: int = 0
    simulated_s: float = 0.0

    def inject(self, fault: str, times: int = 1) -> None:
        """So many more of a fault."""
        self.injected[fault] = self.injected.get(fault, 0) + times

    def holds(self, condition: Any, otherwise: str) -> None:
        """An invariant; `otherwise` is said if it does not hold."""
        self.checks += 1
        if not condition:
            self.wrong.append(otherwise)


def digest(*values: Any) -> str:
    """16 hex digits of arrays, numbers and texts, bit by bit, and of the order of dicts."""
    whole = msgspec.msgpack.encode(values, enc_hook=_content)
    return hashlib.blake2b(whole, digest_size=8).hexdigest()


def _content(value: Any) -> Any:
    """Return what msgspec can encode in place of a value that it does not know."""
    if isinstance(value, (np.ndarray, np.generic)):
        return np.ascontiguousarray(value).tobytes()
    return repr(value)
