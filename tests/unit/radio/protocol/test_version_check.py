"""Which protocol a drone's firmware must speak for what it is sent."""

import pytest

from crazychoir.errors import ConfigError
from crazychoir.platforms import CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS
from crazychoir.radio.protocol.crtp import CRTP_FORMAT, FIRST_VERSIONS, PACKET_FORMS
from crazychoir.radio.protocol.handlers import RADIO_HANDLERS
from crazychoir.radio.protocol.version_check import check_protocol

LEAST = {"fpqr": -1, "frpy": -1, "vel": 9, "xyz": 8, "fullstate": -1}


@pytest.mark.parametrize("kind", RADIO_HANDLERS)
def test_each_sender_says_what_it_needs(kind: str) -> None:
    for version in range(-1, CRTP_FORMAT.version + 1):
        if version >= LEAST[kind]:
            check_protocol(version, kind, CRAZYFLIE_21, "drone 3")
        else:
            with pytest.raises(
                ConfigError,
                match=f"{LEAST[kind]} or newer, for {RADIO_HANDLERS[kind].form}",
            ):
                check_protocol(version, kind, CRAZYFLIE_21, "drone 3")


@pytest.mark.parametrize("kind", RADIO_HANDLERS)
def test_a_drone_that_must_be_armed_needs_protocol_12_with_every_sender(
    kind: str,
) -> None:
    check_protocol(12, kind, CRAZYFLIE_21_BRUSHLESS, "drone 3")
    with pytest.raises(
        ConfigError,
        match=rf"12 or newer, for arm \(sender {kind} on .*\)\. Write newer firmware\.$",
    ):
        check_protocol(11, kind, CRAZYFLIE_21_BRUSHLESS, "drone 3")


def test_the_refusal_says_the_numbers_and_what_to_do() -> None:
    with pytest.raises(ConfigError) as refused:
        check_protocol(8, "vel", CRAZYFLIE_21, "drone 3")
    assert str(refused.value) == (
        "drone 3: protocol of its firmware: found version 8; allowed: 9 or newer, for velocity_world (sender vel on "
        "cf21). Write newer firmware, or choose another sender in [control]: fpqr, frpy, xyz, fullstate."
    )
    with pytest.raises(ConfigError, match="found no version"):
        check_protocol(-1, "xyz", CRAZYFLIE_21, "drone 3")


def test_the_version_table_names_only_known_forms_and_existing_versions() -> None:
    assert FIRST_VERSIONS.keys() <= PACKET_FORMS.keys()
    assert max(FIRST_VERSIONS.values()) == CRTP_FORMAT.version
