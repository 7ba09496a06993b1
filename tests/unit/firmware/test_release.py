"""Releases are read from the texts that firmware tells."""

import pytest

from crazychoir.firmware.release import (
    DESCRIBED_RELEASE,
    THRUST_RELEASES,
    parse_release,
)


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("2025.12", (2025, 12)),
        ("2025.12.1 +3", (2025, 12)),
        ("2025.02", (2025, 2)),
        ("2025.13", None),
        ("2016.11", None),
        ("release", None),
        ("", None),
    ],
)
def test_a_release_has_a_year_and_a_month(text, number):
    assert parse_release(text) == number


def test_the_described_release_has_thrust_that_is_linear_in_newtons():
    assert parse_release(DESCRIBED_RELEASE) >= THRUST_RELEASES.linear_since
