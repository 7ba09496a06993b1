"""What counts as the answer of a firmware."""

import struct
from types import SimpleNamespace

import pytest

from crazychoir.errors import LinkFailed
from crazychoir.firmware.requests import PARAMETER_CHANNELS
from crazychoir.radio.link.firmware import (
    ConnectedFirmware,
    CrtpPort,
    _is_write_answer,
)
from crazychoir.radio.protocol.crtp import Packet

ONE, ZERO = (
    Packet(CrtpPort.PARAMETERS, PARAMETER_CHANNELS.write, struct.pack("<HB", 7, value))
    for value in (1, 0)
)
FLOAT = Packet(
    CrtpPort.PARAMETERS, PARAMETER_CHANNELS.write, struct.pack("<Hf", 7, 1.0)
)
ERROR = Packet(CrtpPort.PARAMETERS, PARAMETER_CHANNELS.write, struct.pack("<HB", 7, 2))


@pytest.mark.parametrize(
    ("asked", "packet", "answers"),
    [
        (ZERO, ZERO, True),
        (ZERO, ONE, False),  # the second answer to an earlier value, late
        (FLOAT, FLOAT, True),
        (FLOAT, ERROR, True),
        (
            FLOAT,
            Packet(
                CrtpPort.PARAMETERS,
                PARAMETER_CHANNELS.write,
                struct.pack("<Hf", 7, 2.0),
            ),
            False,
        ),
        (
            FLOAT,
            Packet(
                CrtpPort.PARAMETERS,
                PARAMETER_CHANNELS.write,
                struct.pack("<Hf", 8, 1.0),
            ),
            False,
        ),
        (
            FLOAT,
            Packet(CrtpPort.PARAMETERS, PARAMETER_CHANNELS.write + 1, FLOAT.data),
            False,
        ),
    ],
)
def test_an_answer_to_a_write_is_the_value_that_was_asked_or_an_error(
    asked, packet, answers
) -> None:
    assert _is_write_answer(asked, packet) is answers


class Takes:
    """A connection to a firmware that has one parameter, of this kind, and takes what it is told."""

    uri = "udp://127.0.0.1:19850"

    def __init__(self, ctype: str, pytype: str) -> None:
        element = SimpleNamespace(
            ident=7, ctype=ctype, pytype=pytype, access=0, RO_ACCESS=1
        )
        toc = SimpleNamespace(get_element_by_complete_name=lambda name: element)
        self.cf = SimpleNamespace(param=SimpleNamespace(toc=toc))
        self.said: list[bytes] = []

    async def ask(self, packet, answers, deadline, again):
        self.said.append(packet.data[2:])
        return packet


@pytest.mark.parametrize(
    ("ctype", "pytype", "good", "bad", "allowed"),
    [
        (
            "uint8_t",
            "<B",
            (0, 255),
            (700, -1, "much", None, [1], float("nan"), float("inf")),
            "0 to 255",
        ),
        ("uint32_t", "<L", (4_294_967_295,), (1 << 32,), "0 to 4294967295"),
        ("int16_t", "<h", (-32768, 32767), (32768,), "-32768 to 32767"),
        (
            "float",
            "<f",
            (3.4e38, -1),
            (1e39, float("inf"), float("nan"), "much", None),
            "finite numbers, -3.4028e+38",
        ),
    ],
)
async def test_a_parameter_out_of_the_range_of_its_type_is_refused_with_that(
    ctype, pytype, good, bad, allowed
) -> None:
    link = Takes(ctype, pytype)
    for value in good:
        await ConnectedFirmware(link).set("ring.effect", value)
    assert link.said == [struct.pack(pytype, value) for value in good]
    for value in bad:
        with pytest.raises(LinkFailed) as refused:
            await ConnectedFirmware(link).set("ring.effect", value)
        assert f"parameter ring.effect = {value!r}; allowed: {allowed}" in str(
            refused.value
        )
        assert str(refused.value).endswith(f"({ctype})")
    assert len(link.said) == len(good)
