"""Damaged frames and payloads, from a seed: what a decoder must survive."""

import random
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.frames import Envelope, Frame, decode_frame, encode_frame
from crazychoir.errors import CodecError
from crazychoir.types import (
    FPQR,
    Acceleration,
    Failure,
    FullState,
    Goto,
    Pose,
    State,
    Status,
)

VALUES: tuple[Any, ...] = (
    None,
    3.5,
    -7,
    "a name, äöü",
    b"raw",
    [1, 2.0, "x", None, [True]],
    {"x": np.arange(6.0), "k": 3, "edges": {(0, 1): 0.5, (1, 2): 0.25}},
    {1: State.at([1.0, 2.0, 3.0]), 2: State.at([0.0, 0.0, 1.0])},
    np.arange(6.0),
    np.arange(24, dtype=np.float32).reshape(2, 3, 4),
    np.array([[True, False]]),
    np.array(2.5),
    np.zeros((0, 3), np.uint16),
    Pose(np.arange(7.0), 0.01),
    State.at([1.0, 2.0, 3.0]),
    Acceleration(np.ones(3), 0.5),
    FullState.at([1.0, 2.0, 3.0]),
    Goto(np.ones(3), 0.1, 2.0),
    FPQR(np.ones(4)),
    Status("flying", task="ring", suspect=[3], note="ü"),
    Failure(3, "x = nan"),
)
ATTACKS = (
    *(
        bytes([head]) + b"\xff\xff\xff\xff" for head in (0xDB, 0xDD, 0xDF, 0xC6, 0xC9)
    ),  # str, array, map, bin, ext 32
    *(bytes([head]) + b"\xff\xff" for head in (0xDA, 0xDC, 0xDE, 0xC5, 0xC8)),
    b"\x91" * 40,
    b"\x91" * 2000,
    b"\x81\xa1a" * 100,
    b"\xd6\xff\x00\x00\x00\x00",  # a timestamp
    b"\xa2\xff\xfe",  # not UTF-8
    b"\xff" * 8,
    b"\xc1",
)


def payloads() -> list[bytes]:
    """Valid payloads of every kind."""
    return [encode(value) for value in VALUES]


def frames() -> list[bytes]:
    """Valid frames with those payloads."""
    envelopes = [
        Envelope(k, 3, (1, 2), 100 + k, k, 0.01, "bearing", payload)
        for k, payload in enumerate(payloads())
    ]
    return [
        encode_frame(Frame("cf3", 1 << 63, 2, envelopes[k : k + 3]))
        for k in range(0, len(envelopes), 2)
    ]


def mutants(corpus: list[bytes], count: int, seed: int) -> Iterator[bytes]:
    """`count` damaged variants of the corpus."""
    rng = random.Random(seed)  # noqa: S311 - repeatable, not secret
    for _ in range(count):
        data = bytearray(rng.choice(corpus))
        for _ in range(rng.choice((1, 1, 1, 2, 4))):
            data = rng.choice(DAMAGES)(rng, data, corpus)
        yield bytes(data)


def flip(rng: random.Random, data: bytearray, corpus: list[bytes]) -> bytearray:
    if data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return data


def overwrite(rng: random.Random, data: bytearray, corpus: list[bytes]) -> bytearray:
    if data:
        data[rng.randrange(min(len(data), 24))] = rng.randrange(256)
    return data


def truncate(rng: random.Random, data: bytearray, corpus: list[bytes]) -> bytearray:
    return data[: rng.randint(0, len(data))]


def splice(rng: random.Random, data: bytearray, corpus: list[bytes]) -> bytearray:
    other = rng.choice(corpus)
    return data[: rng.randint(0, len(data))] + other[rng.randint(0, len(other)) :]


def attack(rng: random.Random, data: bytearray, corpus: list[bytes]) -> bytearray:
    place, blow = rng.randint(0, len(data)), rng.choice(ATTACKS)
    return data[:place] + blow + data[place + rng.choice((0, 1, len(blow))) :]


def noise(rng: random.Random, data: bytearray, corpus: list[bytes]) -> bytearray:
    return data[: rng.choice((0, 1, 2))] + rng.randbytes(rng.randrange(64))


DAMAGES = (flip, flip, overwrite, truncate, splice, attack, noise)


def campaign(
    count: int, seed: int, decode_payload: Callable[[bytes], Any] = decode
) -> dict[str, int]:
    """Decode damaged frames and payloads; what is still a value must encode again. Any error but CodecError escapes."""
    seen = {"frames": 0, "values": 0, "refused": 0}
    for data in mutants(frames(), count // 2, seed):
        try:
            frame = decode_frame(data)
        except CodecError:
            seen["refused"] += 1
            continue
        seen["frames"] += 1
        for envelope in frame.envelopes:
            judge(envelope.payload, decode_payload, seen)
    for data in mutants(payloads(), count - count // 2, seed + 1):
        judge(data, decode_payload, seen)
    return seen


def judge(
    payload: bytes, decode_payload: Callable[[bytes], Any], seen: dict[str, int]
) -> None:
    try:
        value = decode_payload(payload)
    except CodecError:
        seen["refused"] += 1
        return
    seen["values"] += 1
    encode(value)
