"""Lists of whole numbers as a user writes them."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.config.number_lists import parse_spans
from crazychoir.errors import ConfigError

WORDS = st.lists(
    st.tuples(st.integers(0, 60), st.integers(0, 9)), min_size=1, max_size=6
)
BLANKS = st.sampled_from(["", " ", "  "])


@given(words=WORDS, blank=BLANKS, zeros=st.sampled_from(["", "0", "000"]))
def test_numbers_and_ranges_are_read_each_number_once(words, blank, zeros):
    text = ",".join(
        f"{blank}{zeros}{a}{blank}-{blank}{a + n}" if n else f"{blank}{a}{blank}"
        for a, n in words
    )
    expected = dict.fromkeys(k for a, n in words for k in range(a, a + n + 1))
    assert parse_spans(text, "--drones", "drones") == list(expected)


@given(first=st.integers(0, 50), far=st.integers(0, 50), step=st.integers(1, 60))
def test_a_step_leaves_numbers_out(first, far, step):
    found = parse_spans(
        f"{first}-{first + far}:{step}", "--channels", "channels", 125, steps=True
    )
    assert found == list(range(first, first + far + 1, step))


@pytest.mark.parametrize(
    ("text", "do"),
    [
        ("", "It names none"),
        ("  ", "It names none"),
        ("1,", "a comma too many"),
        (",1", "a comma too many"),
        ("1,,2", "a comma too many"),
        ("1;2", "Write commas"),
        ("1 2", "Write commas"),
        ("7-5", "Write the lower one first: 5-7"),
        ("3,7-5", "Write the lower one first: 5-7"),
        ("10000", "The largest number is 9999"),
        ("0-10000", "The largest number is 9999"),
        ("0-99999999", "The largest number is 9999"),
        ("0-" + "9" * 5000, "The largest number is 9999"),
        ("9" * 5000, "The largest number is 9999"),
        ("0-8:2", "as 3,5-7"),
        ("-3", "as 3,5-7"),
        ("3-", "as 3,5-7"),
        ("1-2-3", "as 3,5-7"),
        ("nan", "as 3,5-7"),
        ("1.0", "as 3,5-7"),
        ("1e3", "as 3,5-7"),
        ("+3", "as 3,5-7"),
        ("٣", "as 3,5-7"),
        ("all", "as 3,5-7"),
    ],
    ids=lambda text: text[:12],
)
def test_what_names_no_drones_is_refused_at_once_with_the_option(text, do):
    began = time.perf_counter()
    with pytest.raises(ConfigError) as refused:
        parse_spans(text, "--drones", "drones, as 3,5-7")
    assert time.perf_counter() - began < 1.0, "no range is counted through"
    assert str(refused.value).startswith("--drones: found")
    assert do in str(refused.value)
    assert len(str(refused.value)) < 300


def test_a_step_of_nothing_and_a_range_where_there_is_none_are_refused():
    with pytest.raises(ConfigError, match="A step is 1 or more"):
        parse_spans("0-8:0", "--channels", "channels", steps=True)
    with pytest.raises(ConfigError, match="--edge"):
        parse_spans("1-2", "--edge", "two drones", ranges=False)
