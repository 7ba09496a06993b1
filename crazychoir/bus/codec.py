"""Encodes any value as the bytes of a payload and decodes it; received bytes can never run code.

    payload = tag (1 byte: format version in the upper 2 bits, kind in the lower 6) + body

The kinds are 0 msgpack, 1 float, 2 and 3 arrays (array_codec.py), and from 16 on wire types. Inside
a container, an array or a wire type is a msgpack extension that holds a whole payload.
"""

import re
import struct
from collections.abc import Callable, Iterable
from enum import IntEnum
from typing import Any, Final

import msgspec
import numpy as np

from crazychoir import types
from crazychoir.bus.array_codec import (
    PAYLOAD_FORMAT,
    ArrayPayload,
    Decode,
    Encode,
    Payload,
    WireType,
    decode_array,
    decode_vector,
    encode_array,
    flat_layout,
)
from crazychoir.errors import CodecError, error_text
from crazychoir.files.path_texts import readable_texts

MAX_PAYLOAD: Final = 600_000
"""Bytes of one payload.

A message of this size fits into a frame, so every encoded value can leave the process.
"""
MAX_DEPTH: Final = 32
"""Levels of containers within containers."""
WIRE_LAYOUTS: Final[dict[str, tuple[int, ...]]] = {
    "Pose": (16, 7),
    "State": (17, 13, 3),
    "Acceleration": (18, 3),
    "FullState": (19, 14),
    "Goto": (20, 3),
    "FPQR": (21, 4),
    "Status": (22, 0),
    "FRPY": (23, 4),
    "Vel": (24, 4),
    "XYZ": (25, 0),
    "Body": (26, 0),
    "Failure": (27, 0),
    "Acc": (40, 3),
    "Drive": (41, 2),
    "Velocity": (42, 3),
    "Plan": (43, 0),
    "LinkStatus": (44, 0),
    "HoldRequest": (45, 0),
    "HoldAnswer": (46, 0),
}
"""Wire types by class name: (kind, n) or (kind, n, m).

kind: 16 to 63; a kind that was ever used is never given to another class
n: length of the first field, a float64 vector that only floats follow; 0 for other fields
m: length of the last field, if it is a second vector
"""


class _PlainPayload(IntEnum):
    """The first byte of the payload of a value that is neither an array nor a wire type."""

    MSGPACK = PAYLOAD_FORMAT.version << 6
    """A value in msgpack."""
    FLOAT = PAYLOAD_FORMAT.version << 6 | 1
    """A float."""


_EXTENSION_CODE = 1  # msgpack extension code; its data is a payload
_LEAF_TYPES = frozenset({type(None), bool, int, float, str, bytes})
"""Types that msgpack takes as they are."""
_LITTLE_FLOAT64 = np.dtype("<f8")
_FLOAT_BODY = struct.Struct("<Bd")
"""Layout of a float's payload."""
_MSGPACK_HEAD = bytes([_PlainPayload.MSGPACK])
"""Head of a msgpack payload."""


def encode(value: Any, limit: int = MAX_PAYLOAD) -> bytes:
    r"""Return the bytes of a value: None, bool, int, float, str, bytes, list, tuple, dict, numpy
    array or scalar, wire type; also nested.

    Tuples arrive as lists (as tuples in the keys of a dict), numpy scalars as Python's. In texts,
    bytes of file names that are not UTF-8 arrive as \xfc.
    limit: most bytes of the payload
    Raises CodecError with the place in the value, what was found, and what is allowed.
    """
    try:
        payload = _encoder_by_type.get(type(value), _encode_generic)(value)
    except UnicodeEncodeError:
        payload = _encode_readable(value)
    except Exception as error:
        raise _encoding_error(value, error) from error
    if len(payload) > limit:
        raise CodecError(
            f"value: {len(payload)} bytes when encoded; allowed: {limit}. Send less, or in parts."
        )
    return payload


def decode(payload: Payload, limit: int = MAX_PAYLOAD) -> Any:
    """Return the value of a payload.

    Arrays are read-only. Outside of a container they are views of the payload.
    limit: most bytes of the payload
    Raises CodecError, and no other error, for invalid bytes.
    """
    try:
        if type(payload) is not bytes:
            payload = memoryview(payload).toreadonly()
        if len(payload) > limit:
            raise CodecError(f"payload: {len(payload)} bytes; allowed: {limit}.")
        return _decoder_by_kind[payload[0]](payload)
    except CodecError:
        raise
    except Exception as error:
        raise CodecError(f"payload: cannot be decoded: {error_text(error)}") from error


def register(cls: type[WireType]) -> type[WireType]:
    """Let a wire type travel; its kind is in WIRE_LAYOUTS. Can be used as a decorator.

    Raises CodecError if WIRE_LAYOUTS does not have the type, or a field has an unsuitable type.
    """
    if cls.__name__ not in WIRE_LAYOUTS:
        raise CodecError(
            f"{cls.__qualname__}: is not in codec.WIRE_LAYOUTS, which has {', '.join(WIRE_LAYOUTS)}. Add it there."
        )
    kind, *sizes = WIRE_LAYOUTS[cls.__name__]
    tag = PAYLOAD_FORMAT.version << 6 | kind
    _decoded_types.add(cls)
    _encoder_by_type[cls], _decoder_by_kind[tag] = (
        flat_layout(cls, tag, *sizes) if sizes[0] else _make_wire_codec(cls, tag)
    )
    return cls


def _encode_readable(value: Any) -> bytes:
    """Return the bytes of a value after its texts are made valid UTF-8."""
    try:
        texts = readable_texts(value, "strict")
        return _encoder_by_type.get(type(texts), _encode_generic)(texts)
    except Exception as error:
        raise _encoding_error(value, error) from error


def _encode_float(value: float) -> bytes:
    return _FLOAT_BODY.pack(_PlainPayload.FLOAT, value)


def _decode_float(payload: Payload) -> float:
    number: float = _FLOAT_BODY.unpack(payload)[1]
    return number


def _make_wire_codec(cls: type[WireType], tag: int) -> tuple[Encode, Decode]:
    """Return the codec of a wire type with any fields.

    The body is the msgpack of their list, checked against their types on arrival. Arrays are
    float64 of any shape.
    """
    shown = repr(msgspec.inspect.type_info(cls))
    if re.search(
        r"AnyType|CustomType\(cls=<class '(?!numpy\.ndarray)|.StructType", shown
    ):
        raise CodecError(
            f"{cls.__qualname__}: a field is Any, a struct or a class; allowed: plain types and arrays."
        )
    head = bytes([tag])
    fields = msgspec.msgpack.Encoder(enc_hook=_encode_field).encode
    decoder = msgspec.msgpack.Decoder(cls, ext_hook=_decode_field_extension)

    def encode_fields(value: Any) -> bytes:
        body = fields(value)
        decoder.decode(body)  # a wrong type is the sender's mistake: raise it there
        return head + body

    return encode_fields, lambda payload: decoder.decode(payload[1:])


def _encode_generic(value: Any) -> bytes:
    return _MSGPACK_HEAD + _encode_msgpack(
        value if type(value) in _LEAF_TYPES else _to_msgpack(value, 1)
    )


def _to_msgpack(value: Any, depth: int) -> Any:
    """Return the value in a form for msgpack: arrays and wire types become extensions.

    A container without such values is returned as it is.
    """
    kind = type(value)
    if kind in _LEAF_TYPES:
        return value
    if kind is dict and depth <= MAX_DEPTH:
        if _are_leaf_types(map(type, value)) and _are_leaf_types(
            map(type, value.values())
        ):
            return value
        return {
            _to_key(key): _to_msgpack(item, depth + 1) for key, item in value.items()
        }
    if (kind is list or kind is tuple) and depth <= MAX_DEPTH:
        return (
            value
            if _are_leaf_types(map(type, value))
            else [_to_msgpack(item, depth + 1) for item in value]
        )
    if kind in _encoder_by_type:
        return msgspec.msgpack.Ext(_EXTENSION_CODE, _encoder_by_type[kind](value))
    return _to_leaf(value)


def _to_leaf(value: Any) -> Any:
    """Return a leaf, or the Python value of a numpy scalar; raise TypeError for other values."""
    if isinstance(value, np.generic):
        value = value.item()
    if type(value) not in _LEAF_TYPES:
        raise TypeError
    return value


def _to_key(key: Any) -> Any:
    """Return the key of a dict: a leaf, or a tuple of leaves (an edge of a graph)."""
    return tuple(map(_to_leaf, key)) if type(key) is tuple else _to_leaf(key)


def _encode_field(value: Any) -> Any:
    """Return the form of a field of a wire type that msgpack does not know."""
    if type(value) is np.ndarray and value.dtype == _LITTLE_FLOAT64:
        return msgspec.msgpack.Ext(_EXTENSION_CODE, encode_array(value))
    return _to_leaf(value)


def _decode_generic(payload: Payload) -> Any:
    value = _decode_msgpack(payload[1:])
    if type(value) not in _LEAF_TYPES:
        _check_decoded([value], 0)
    return value


def _check_decoded(value: Any, depth: int) -> None:
    """Raise CodecError for values that no sender encodes: too deep
    containers, msgpack timestamps, strange keys.
    """
    if depth > MAX_DEPTH:
        raise CodecError(
            f"payload: more than {MAX_DEPTH} containers within each other."
        )
    if type(value) is dict:
        if not _are_leaf_types(map(type, value)):
            _check_keys(value)
        value = value.values()
    if not _are_decoded_types(map(type, value)):
        for item in value:
            if type(item) is list or type(item) is dict:
                _check_decoded(item, depth + 1)
            elif type(item) not in _decoded_types:
                raise CodecError(f"payload: found a {type(item).__name__}.")


def _check_keys(keys: Iterable[Any]) -> None:
    for key in keys:
        if type(key) not in _LEAF_TYPES and not (
            type(key) is tuple and _are_leaf_types(map(type, key))
        ):
            raise CodecError(f"payload: found a {type(key).__name__} in a key.")


def _decode_extension(code: int, data: memoryview) -> Any:
    """Return an array or a wire type inside a container.

    Its bytes are copied, to align its numbers.
    """
    payload = bytes(data)
    if code != _EXTENSION_CODE or payload[0] in (
        _PlainPayload.MSGPACK,
        _PlainPayload.FLOAT,
    ):
        raise CodecError(f"payload: found extension {code}, kind {payload[0]}.")
    return _decoder_by_kind[payload[0]](payload)


def _decode_field_extension(code: int, data: memoryview) -> types.Vec:
    """Return a float64 array in a field of a wire type."""
    payload = bytes(data)
    if code != _EXTENSION_CODE or payload[0] not in (
        ArrayPayload.VECTOR,
        ArrayPayload.ARRAY,
    ):
        raise CodecError(
            f"payload: found extension {code}, kind {payload[0]} in a field."
        )
    array: types.Vec = _decoder_by_kind[payload[0]](payload)
    if array.dtype is not _LITTLE_FLOAT64:
        raise CodecError(
            f"payload: found an array of {array.dtype} in a field; allowed: float64."
        )
    return array


def _refuse_unknown_kind(payload: Payload) -> Any:
    version = payload[0] >> 6
    kind = payload[0] & 63
    if version != PAYLOAD_FORMAT.version:
        raise CodecError(
            f"payload: format version {version}; allowed: {PAYLOAD_FORMAT.version}. Run one version of crazychoir."
        )
    raise CodecError(f"payload: kind {kind} is not registered.")


def _encoding_error(value: Any, error: Exception) -> CodecError:
    where, found = _find_culprit(value, "value", 1) or (
        "value",
        f"{_describe_value(value)} ({error})",
    )
    names = ", ".join(
        cls.__name__ for cls in _encoder_by_type if issubclass(cls, types.Wire)
    )
    return CodecError(
        f"{where}: found {found}; allowed: None, bool, int of 64 bits, float, str, bytes, list, tuple, dict (its keys: "
        f"scalars and tuples of them), at most {MAX_DEPTH} within each other; numpy arrays of "
        f"{', '.join(PAYLOAD_FORMAT.dtype_names)}, "
        f"at most {PAYLOAD_FORMAT.max_dimensions} dimensions; {names}."
    )


def _find_culprit(value: Any, where: str, depth: int) -> tuple[str, str] | None:
    """Return the place and a description of the first part that cannot be encoded, or None."""
    if type(value) not in (list, tuple, dict):
        return _describe_trouble(lambda part: _to_msgpack(part, depth), value, where)
    if depth > MAX_DEPTH:
        return where, "one container more than is allowed"
    found = None
    for name, item in value.items() if type(value) is dict else enumerate(value):
        if type(value) is dict:
            found = _describe_trouble(_to_key, name, f"a key of {where}")
        found = found or _find_culprit(item, f"{where}[{name!r}]", depth + 1)
        if found:
            break
    return found


def _describe_trouble(
    form: Callable[[Any], Any], value: Any, where: str
) -> tuple[str, str] | None:
    try:
        _encode_msgpack(form(value))
    except Exception as error:  # noqa: BLE001 - the text reports any error of this part
        return where, f"{_describe_value(value)} ({error})" if str(
            error
        ) else _describe_value(value)
    return None


def _describe_value(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"a {type(value).__name__} of {value.dtype}, shape {value.shape}"
    kind = type(value)
    return (
        f"a {kind.__qualname__}"
        if kind.__module__ == "builtins"
        else f"a {kind.__module__}.{kind.__qualname__}"
    )


_are_leaf_types = _LEAF_TYPES.issuperset
_decoded_types: set[type] = {*_LEAF_TYPES, np.ndarray}
"""Types that may be in a decoded payload, in addition to lists and dicts."""
_are_decoded_types = _decoded_types.issuperset
_encode_msgpack = msgspec.msgpack.Encoder().encode
_decode_msgpack = msgspec.msgpack.Decoder(ext_hook=_decode_extension).decode
_encoder_by_type: dict[type, Encode] = {float: _encode_float, np.ndarray: encode_array}
_decoder_by_kind: list[Decode] = [_refuse_unknown_kind] * 256
_decoder_by_kind[_PlainPayload.MSGPACK] = _decode_generic
_decoder_by_kind[_PlainPayload.FLOAT] = _decode_float
_decoder_by_kind[ArrayPayload.VECTOR] = decode_vector
_decoder_by_kind[ArrayPayload.ARRAY] = decode_array
for _cls in (
    types.Pose,
    types.State,
    types.Acceleration,
    types.FullState,
    types.Goto,
    types.FPQR,
    types.Status,
    types.FRPY,
    types.Vel,
    types.XYZ,
    types.Body,
    types.Failure,
    types.Acc,
    types.Drive,
    types.Velocity,
    types.Plan,
    types.LinkStatus,
):
    register(_cls)
