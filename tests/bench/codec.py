"""Cost of the codec, of frames and of verdicts, in us a call, beside pickle and plain msgspec.

python tests/bench/codec.py
"""

import pickle
import timeit
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.frames import (
    Envelope,
    Frame,
    FrameBuffer,
    decode_frame,
    encode_frame,
)
from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.random_draws import bad_states
from crazychoir.types import Goto, State, Status

VALUES: dict[str, Any] = {
    "float64 (6,)": np.arange(6.0),
    "float": 1.5,
    "State": State.at([1.0, 2.0, 3.0]),
    "Goto": Goto(np.ones(3), 0.5, 2.0),
    "Status": Status("flying"),
    "float64 (2, 3)": np.ones((2, 3)),
    "3 floats": [1.0, 2.0, 3.0],
    "dict of vector, int": {"x": np.arange(6.0), "k": 3},
    "dict of 2 States": {1: State.at([1.0, 2.0, 3.0]), 2: State.at([0.0, 0.0, 1.0])},
    "1000 floats": [0.5 * k for k in range(1000)],
    "100 x 3 floats": [[1.0, 2.0, 3.0] for _ in range(100)],
    "float64 (10000,)": np.arange(10_000.0),
}


def us(call: Callable[[], Any]) -> float:
    """Least of five timings, each of about 20 ms."""
    timer = timeit.Timer(call)
    count = max(1, int(0.02 / max(timer.timeit(3) / 3, 1e-7)))
    return min(timer.repeat(5, count)) / count * 1e6


def plain_encode(value: Any) -> bytes:
    """What one writes with msgspec alone: the bytes of an array, without shape, dtype or class."""
    return msgspec.msgpack.encode(value, enc_hook=np.ndarray.tobytes)


def payloads() -> None:
    row = "{:22} {:>7} {:>9} {:>9} {:>9} {:>9} {:>9}"
    print(
        row.format("payload", "bytes", "encode", "decode", "both", "pickle", "msgspec")
    )
    for name, value in VALUES.items():
        payload, pickled, plain = (
            encode(value),
            pickle.dumps(value, 5),
            plain_encode(value),
        )
        ours = us(lambda: encode(value)), us(lambda: decode(payload))  # noqa: B023
        other = us(lambda: pickle.dumps(value, 5)) + us(lambda: pickle.loads(pickled))  # noqa: B023, S301
        third = us(lambda: plain_encode(value)) + us(  # noqa: B023
            lambda: msgspec.msgpack.decode(plain)  # noqa: B023
        )
        times = [f"{time:.2f}" for time in (*ours, sum(ours), other, third)]
        print(row.format(name, len(payload), *times))


def frames() -> None:
    payload = encode(State.at([1.0, 2.0, 3.0]))
    envelopes = [
        Envelope(16, i, (1, 2, 3), 7, 0, 0.0, "bearing", payload) for i in range(30)
    ]
    frame = Frame("cf0", 1 << 63, 2, envelopes)
    data = encode_frame(frame)
    print(f"\nframe of 30 States, {len(data)} bytes, us an envelope")
    print(
        f"encode {us(lambda: encode_frame(frame)) / 30:.3f}  decode {us(lambda: decode_frame(data)) / 30:.3f}"
    )
    for conflate in (False, True):
        buffer = FrameBuffer("cf0", 1 << 63, 2, conflate)
        print(
            f"add and take, conflate={conflate}: {us(lambda: fill(buffer, envelopes)) / 30:.3f}"  # noqa: B023
        )


def fill(buffer: FrameBuffer, envelopes: list[Envelope]) -> list[bytes]:
    for envelope in envelopes:
        buffer.add(envelope)
    return buffer.take()


def verdicts() -> None:
    print("\nverdict, us")
    idle = Impairment(1)
    print(f"{'nothing set: active':22} {us(lambda: idle.active):.3f}")
    for name, effects in {
        "loss": {"loss": 0.3},
        "bursts": {"p_good_bad": 0.02, "p_bad_good": 0.2},
        "loss, delay, jitter": {"loss": 0.1, "delay": 0.01, "jitter": 0.01},
        "all but bandwidth": {
            "loss": 0.1,
            "delay": 0.01,
            "jitter": 0.01,
            "duplicate": 0.1,
            "reorder": 0.1,
        },
        "bandwidth": {"bandwidth": 1e9},
    }.items():
        impairment, count = Impairment(1), iter(range(1 << 40))
        impairment.update(effects)
        print(
            f"{name:22} {us(lambda: impairment.verdict(1, 2, 'bearing', next(count), 0, 100, 0.5)):.3f}"  # noqa: B023
        )
    print(
        f"{'a block of 256 states':22} {us(lambda: bad_states(5, 20, 0.02, 0.2)):.3f}"
    )


if __name__ == "__main__":
    payloads()
    frames()
    verdicts()
