"""Which channels are taken: parsing, and the choice against all choices."""

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.errors import ConfigError
from crazychoir.radio.protocol.channels import frequency, parse_channels, pick_channels


@pytest.mark.parametrize(
    ("text", "channels"),
    [
        ("0-8:2", (0, 2, 4, 6, 8)),
        ("0-3", (0, 1, 2, 3)),
        ("80", (80,)),
        ("7, 4,6-8", (4, 6, 7, 8)),
        ("0-125:60", (0, 60, 120)),
    ],
)
def test_channels_are_read(text, channels):
    assert parse_channels(text) == channels


@pytest.mark.parametrize(
    "text", ["", "a", "3-1", "126", "0-126", "-4", "0-8:0", "1;2", "1,"]
)
def test_what_are_no_channels_is_refused(text):
    with pytest.raises(ConfigError, match="0 to 125"):
        parse_channels(text)


def test_a_channel_is_a_megahertz():
    assert frequency(80) == 2480


# Few values, halves: many ties, and sums without rounding.
SCORES = st.dictionaries(
    st.integers(0, 30),
    st.tuples(st.integers(0, 3), st.integers(0, 4).map(lambda n: n / 2)),
    min_size=1,
    max_size=9,
)


@given(scores=SCORES, k=st.integers(1, 4), spacing=st.integers(1, 8))
def test_the_choice_is_the_best_of_all_choices(scores, k, spacing):
    allowed = [
        c
        for c in combinations(sorted(scores), k)
        if all(b - a >= spacing for a, b in combinations(c, 2))
    ]
    if not allowed:
        with pytest.raises(ConfigError, match="room for"):
            pick_channels(scores, k, spacing)
        return
    least = max(min(scores[c][0] for c in chosen) for chosen in allowed)
    good = [chosen for chosen in allowed if min(scores[c][0] for c in chosen) == least]
    most = max(sum(scores[c][1] for c in chosen) for chosen in good)
    assert pick_channels(scores, k, spacing) == min(
        ch for ch in good if sum(scores[c][1] for c in ch) == most
    )


def test_the_worst_chosen_counts_not_the_sum():
    scores = {
        0: (0.6, 0.6),
        5: (1.0, 1.0),
        10: (0.6, 0.6),
        4: (0.7, 0.7),
        9: (0.7, 0.7),
    }
    assert pick_channels(scores, 2, 5) == (
        4,
        9,
    )  # 5 is the best alone, and leaves 0 or 10
    assert pick_channels(scores, 1, 5) == (5,)
