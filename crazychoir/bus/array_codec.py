"""Encodes arrays, and wire types that consist of arrays and floats, without msgpack.

Numbers are little endian and begin at a multiple of 8 bytes. Therefore an array that is read from a
payload is an aligned, read-only view of it.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from math import prod
from typing import Any, TypeVar

import msgspec
import numpy as np

from crazychoir.errors import CodecError
from crazychoir.types import Vec, Wire


@dataclass(frozen=True, slots=True)
class PayloadFormat:
    """The format of payloads, and the arrays that it can hold."""

    version: int = 1
    """Version of the format: the upper 2 bits of a payload's first byte."""
    max_dimensions: int = 8
    """Most dimensions of an array."""
    dtype_names: tuple[str, ...] = (
        "float64",
        "float32",
        "int64",
        "int32",
        "int16",
        "uint8",
        "uint16",
        "uint32",
        "uint64",
        "bool",
    )
    """Types of numbers that can travel; the index is the code in the payload, so only append.
    """


PAYLOAD_FORMAT = PayloadFormat()


class ArrayPayload(IntEnum):
    """The first byte of the payload of an array."""

    VECTOR = PAYLOAD_FORMAT.version << 6 | 2
    """A one-dimensional float64 array."""
    ARRAY = PAYLOAD_FORMAT.version << 6 | 3
    """Any other array."""


Payload = bytes | bytearray | memoryview
Encode = Callable[[Any], bytes]
Decode = Callable[[Any], Any]
WireType = TypeVar("WireType", bound=Wire)

_LITTLE_ENDIAN_DTYPES = [
    np.dtype(np.dtype(name).newbyteorder("<").str)
    for name in PAYLOAD_FORMAT.dtype_names
]
"""Little-endian dtypes, by code."""
_DTYPE_CODES = {dtype: code for code, dtype in enumerate(_LITTLE_ENDIAN_DTYPES)}
"""Code of each dtype."""
_BOOL_DTYPE = np.dtype(bool)
_FLOAT64_DTYPE = np.dtype("<f8")
_VECTOR_HEAD = bytes([ArrayPayload.VECTOR]) + bytes(7)
"""Head of a vector's payload."""
_ARRAY_HEADS = [
    struct.Struct(f"<BBB5x{n}Q") for n in range(PAYLOAD_FORMAT.max_dimensions + 1)
]
"""Layout of the head of an array's payload, by number of dimensions."""


def encode_array(value: Any) -> bytes:
    """Return the payload of an array.

    A vector has a head of 8 bytes and its numbers. Any other array has a head with dtype and
    dimensions, its shape, and its numbers.
    Raises KeyError for an unknown dtype, IndexError for too many dimensions.
    """
    if value.dtype is _FLOAT64_DTYPE and value.ndim == 1:
        numbers: bytes = value.tobytes()
        return _VECTOR_HEAD + numbers
    little = value.astype(value.dtype.newbyteorder("<"), copy=False)
    numbers = little.tobytes()
    head: bytes = _ARRAY_HEADS[value.ndim].pack(
        ArrayPayload.ARRAY, _DTYPE_CODES[little.dtype], value.ndim, *value.shape
    )
    return head + numbers


def decode_vector(payload: Payload) -> Vec:
    """Return the (n,) view of a payload of kind VECTOR."""
    return np.frombuffer(payload, _FLOAT64_DTYPE, -1, 8)


def decode_array(payload: Payload) -> Any:
    """Return the view of a payload of kind ARRAY.

    Raises CodecError if its shape and its length do not agree, or a truth value is neither 0 nor 1.
    """
    dtype = _LITTLE_ENDIAN_DTYPES[payload[1]]
    ndim = payload[2]
    head = _ARRAY_HEADS[ndim]
    shape = head.unpack_from(payload)[3:]
    count = prod(shape)
    if count * dtype.itemsize != len(payload) - head.size:
        raise CodecError(
            f"payload: shape {shape} of {dtype} does not fit its {len(payload)} bytes."
        )
    if (
        dtype is _BOOL_DTYPE
        and np.frombuffer(payload, np.uint8, count, head.size).max(initial=0) > 1
    ):
        raise CodecError("payload: a truth value is neither 0 nor 1.")
    return np.frombuffer(payload, dtype, count, head.size).reshape(shape)


def flat_layout(
    cls: type[WireType], tag: int, size: int, more: int = 0
) -> tuple[Encode, Decode]:
    """Return the functions that encode and decode a wire type with one or two vectors.

    The fields of the type are a vector, then any number of floats, then perhaps a second vector. The
    payload is a head (8 bytes), the floats, and the vectors.

    cls: the wire type
    tag: first byte of the payload
    size: length of the first vector
    more: length of the second vector; 0 if there is none
    """
    if more:
        return _flat_layout_of_two(cls, tag, size, more)
    floats = len(cls.__struct_fields__) - 1
    pack = struct.Struct(f"<B7x{floats}d").pack
    unpack = struct.Struct(f"<8x{floats}d").unpack_from
    offset = 8 + 8 * floats
    shape = (size,)
    fields = msgspec.structs.astuple
    from_buffer = np.frombuffer
    length = offset + 8 * size

    def encode_flat(value: Any) -> bytes:
        values = fields(value)
        vector = values[0]
        if (
            type(vector) is not np.ndarray
            or vector.dtype is not _FLOAT64_DTYPE
            or vector.shape != shape
        ):
            vector = _read_vector(vector, shape)
        numbers: bytes = vector.tobytes()
        return pack(tag, *values[1:]) + numbers

    def decode_flat(payload: Payload) -> WireType:
        if len(payload) != length:
            raise CodecError(
                f"payload: {len(payload)} bytes; allowed for {cls.__name__}: {length}."
            )
        return cls(from_buffer(payload, _FLOAT64_DTYPE, size, offset), *unpack(payload))

    return encode_flat, decode_flat


def _flat_layout_of_two(
    cls: type[WireType], tag: int, size: int, more: int
) -> tuple[Encode, Decode]:
    """Return the codec of a wire type of two vectors."""
    floats = len(cls.__struct_fields__) - 2
    pack = struct.Struct(f"<B7x{floats}d").pack
    unpack = struct.Struct(f"<8x{floats}d").unpack_from
    offset = 8 + 8 * floats
    shapes = ((size,), (more,))
    fields = msgspec.structs.astuple
    from_buffer = np.frombuffer
    second = offset + 8 * size
    length = offset + 8 * (size + more)

    def encode_flat(value: Any) -> bytes:
        values = fields(value)
        first = values[0]
        last = values[-1]
        if (
            type(first) is not np.ndarray
            or first.dtype is not _FLOAT64_DTYPE
            or first.shape != shapes[0]
        ):
            first = _read_vector(first, shapes[0])
        if (
            type(last) is not np.ndarray
            or last.dtype is not _FLOAT64_DTYPE
            or last.shape != shapes[1]
        ):
            last = _read_vector(last, shapes[1])
        return pack(tag, *values[1:-1]) + first.tobytes() + last.tobytes()  # type: ignore[no-any-return]

    def decode_flat(payload: Payload) -> WireType:
        if len(payload) != length:
            raise CodecError(
                f"payload: {len(payload)} bytes; allowed for {cls.__name__}: {length}."
            )
        numbers = unpack(payload)
        return cls(
            from_buffer(payload, _FLOAT64_DTYPE, size, offset),
            *numbers,
            from_buffer(payload, _FLOAT64_DTYPE, more, second),
        )

    return encode_flat, decode_flat


def _read_vector(vector: Any, shape: tuple[int]) -> Vec:
    array = np.asarray(vector, dtype=np.float64)
    if array.shape != shape:
        raise TypeError(f"its vector has shape {array.shape}, not {shape}")
    return array
