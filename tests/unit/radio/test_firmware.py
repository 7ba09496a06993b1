"""What counts as the answer of a firmware."""

import struct

import pytest

from crazychoir.radio.crtp import Packet
from crazychoir.radio.firmware import PARAM, WRITE, _taken_or_not

ONE, ZERO = (Packet(PARAM, WRITE, struct.pack("<HB", 7, value)) for value in (1, 0))
FLOAT = Packet(PARAM, WRITE, struct.pack("<Hf", 7, 1.0))
ERROR = Packet(PARAM, WRITE, struct.pack("<HB", 7, 2))


@pytest.mark.parametrize(
    ("asked", "packet", "answers"),
    [
        (ZERO, ZERO, True),
        (ZERO, ONE, False),  # the second answer to an earlier value, late
        (FLOAT, FLOAT, True),
        (FLOAT, ERROR, True),
        (FLOAT, Packet(PARAM, WRITE, struct.pack("<Hf", 7, 2.0)), False),
        (FLOAT, Packet(PARAM, WRITE, struct.pack("<Hf", 8, 1.0)), False),
        (FLOAT, Packet(PARAM, WRITE + 1, FLOAT.data), False),
    ],
)
def test_an_answer_to_a_write_is_the_value_that_was_asked_or_an_error(asked, packet, answers) -> None:
    assert _taken_or_not(asked, packet) is answers
