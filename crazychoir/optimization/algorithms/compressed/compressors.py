"""Compressors: a vector becomes few bytes, and the bytes become nearly the same vector again.

Sender and receiver both calculate with the vector that the bytes give. A compressor Q has the
quality omega, 0 < omega <= 1, if E |Q(x) - x|^2 <= (1 - omega) |x|^2 for all x.
"""

import math
import struct
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.types import Bytes, Ints, Vec

LEAST_BITS: Final = 2
"""Bits of the coarsest quantiser: it has the levels -1, 0 and 1."""
MOST_BITS: Final = 16
"""Bits of the finest quantiser."""
LARGEST_FLOAT32: Final = float(np.finfo(np.float32).max)
"""Larger entries are sent as this."""
_SCALE_LAYOUT: Final = struct.Struct("<f")
"""Layout of the scale of a quantised vector."""


class Compressor(Protocol):
    """A map from vectors to bytes, and back."""

    def encode(self, x: Vec, i: int, k: int) -> bytes:
        """Return the bytes of x (n,), the message number k of agent i."""

    def decode(self, payload: bytes, n: int, i: int, k: int) -> Vec:
        """Return Q(x) (n,) from the bytes that agent i sent as its message number k.

        Raises ValueError if they are not the bytes of a vector of n entries.
        """

    def omega(self, n: int) -> float:
        """Return a lower bound on the quality for vectors of n entries."""


@dataclass(frozen=True)
class Quantised:
    """Quantises each entry to b bits, relative to the largest entry.

        Q(x) = D q,   q = round(x / D),              D = |x|_inf / L,         without dither
        Q(x) = D (q - u),   q = round(x / D + u),    D = |x|_inf / (L - 1/2), with dither
        L = 2^(b-1) - 1,   q from -L to L

    The bytes are |x|_inf as float32, and the q with b bits each. Without dither an entry is off by
    at most D/2 and never by more than itself, and the largest entry is exact. With dither u is drawn
    from -1/2 to 1/2 by a generator that sender and receiver share, so u does not travel. The error
    is then uniform from -D/2 to D/2 whatever x is, of mean 0.

    Source: Widrow & Kollar 2008, "Quantization Noise", Cambridge University Press (subtractive
    dither); Koloskova, Stich & Jaggi 2019, ICML, PMLR 97 (the quality omega).
    """

    bits: int = 4
    """b, 2 to 16."""
    seed: int | None = None
    """Seed of the dither, the same at all agents; None for no dither."""

    def __post_init__(self) -> None:
        if not LEAST_BITS <= self.bits <= MOST_BITS:
            allowed = f"{LEAST_BITS} to {MOST_BITS}"
            raise ConfigError("Quantised: bits", self.bits, allowed)

    @property
    def levels(self) -> int:
        """The largest level L."""
        return int(2 ** (self.bits - 1) - 1)

    def encode(self, x: Vec, i: int, k: int) -> bytes:
        """Return 4 + n b / 8 bytes, rounded up, of x (n,)."""
        scale = _round_up_to_float32(float(np.abs(x).max(initial=0.0)))
        q = np.zeros(len(x))
        if scale > 0.0:
            q = np.rint(x / self._interval(scale) + self._dither(len(x), i, k))
        levels = np.clip(q, -self.levels, self.levels).astype(np.int64)
        bits = pack_bits(levels + self.levels, self.bits)
        return _SCALE_LAYOUT.pack(scale) + bits.tobytes()

    def decode(self, payload: bytes, n: int, i: int, k: int) -> Vec:
        """Return Q(x) (n,)."""
        wanted = _SCALE_LAYOUT.size + math.ceil(n * self.bits / 8)
        if len(payload) != wanted:
            raise ValueError(f"{len(payload)} bytes; allowed: {wanted}")
        (scale,) = _SCALE_LAYOUT.unpack_from(payload)
        if not math.isfinite(scale):
            raise ValueError(f"scale {scale}; allowed: finite numbers")
        packed = np.frombuffer(payload, np.uint8, offset=_SCALE_LAYOUT.size)
        q = unpack_bits(packed, self.bits, n) - self.levels
        if scale == 0.0:
            return np.zeros(n)
        decoded: Vec = self._interval(scale) * (q - self._dither(n, i, k))
        return decoded

    def omega(self, n: int) -> float:
        """Return a lower bound on the quality for vectors of n entries.

            max(1/n, 1 - (n - 1) / (4 L^2))   without dither
            1 - n / (12 (L - 1/2)^2)          with dither

        With dither it may be 0 or less. Then few bits are too coarse for so many entries.
        """
        if self.seed is None:
            return max(1.0 / n, 1.0 - (n - 1) / (4.0 * self.levels**2))
        return 1.0 - n / (12.0 * (self.levels - 0.5) ** 2)

    def _interval(self, scale: float) -> float:
        """Return D, the distance of two levels."""
        return scale / (self.levels - (0.0 if self.seed is None else 0.5))

    def _dither(self, n: int, i: int, k: int) -> Vec:
        """Return u (n,), which depends on the seed, the sender and the number of the message."""
        if self.seed is None:
            return np.zeros(n)
        return np.random.default_rng([self.seed, i, k]).uniform(-0.5, 0.5, n)


@dataclass(frozen=True)
class TopK:
    """Keeps the k entries of the largest magnitude, and sets the others to 0.

    The bytes are the k indices, with 1 byte each up to 256 entries and 2 or 4 bytes beyond, and the
    k values as float32. Of equal magnitudes the first is kept. The quality omega is k / n, but for
    the rounding of float32.

    Source: Stich, Cordonnier & Jaggi 2018, NeurIPS, "Sparsified SGD with memory".
    """

    k: int
    """Entries that are kept, 1 or more."""

    def __post_init__(self) -> None:
        if self.k < 1:
            raise ConfigError("TopK: k", self.k, "1 or more entries")

    def encode(self, x: Vec, i: int, k: int) -> bytes:
        """Return the bytes of x (n,)."""
        kept = np.sort(np.argsort(-np.abs(x), kind="stable")[: self.k])
        values = np.clip(x[kept], -LARGEST_FLOAT32, LARGEST_FLOAT32).astype("<f4")
        return kept.astype(_index_type(len(x))).tobytes() + values.tobytes()

    def decode(self, payload: bytes, n: int, i: int, k: int) -> Vec:
        """Return Q(x) (n,)."""
        index_type = _index_type(n)
        count = min(self.k, n)
        wanted = count * (index_type.itemsize + 4)
        if len(payload) != wanted:
            raise ValueError(f"{len(payload)} bytes; allowed: {wanted}")
        kept = np.frombuffer(payload, index_type, count)
        values = np.frombuffer(payload, "<f4", count, count * index_type.itemsize)
        if kept.max() >= n or not np.isfinite(values).all():
            raise ValueError(f"indices {kept}, values {values}; allowed: below {n}")
        x = np.zeros(n)
        x[kept] = values
        return x

    def omega(self, n: int) -> float:
        """Return k / n."""
        return min(1.0, self.k / n)


def pack_bits(numbers: Ints, bits: int) -> Bytes:
    """Return numbers from 0 to 2^bits - 1 as bytes, `bits` bits each, the lowest bit first."""
    places = np.arange(bits)
    return np.packbits((numbers[:, None] >> places & 1).astype(np.uint8))


def unpack_bits(packed: Bytes, bits: int, count: int) -> Ints:
    """Return the numbers (count,) that `pack_bits` has packed."""
    bit = np.unpackbits(packed, count=count * bits).reshape(count, bits)
    numbers: Ints = bit.astype(np.int64) @ (1 << np.arange(bits))
    return numbers


def _round_up_to_float32(size: float) -> float:
    """Return the smallest float32 that is not below size, at most the largest float32."""
    size = min(size, LARGEST_FLOAT32)
    near = np.float32(size)
    return float(near if near >= size else np.nextafter(near, np.float32(np.inf)))


def _index_type(n: int) -> np.dtype[np.unsignedinteger]:
    """Return the shortest unsigned integer for an index below n."""
    return np.min_scalar_type(max(n - 1, 0)).newbyteorder("<")
