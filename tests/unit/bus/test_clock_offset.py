"""Clocks of two hosts, by what their processes ask each other."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from crazychoir.bus.clock_offset import (
    CLOCK_DRIFT,
    OFFSET_SAMPLES,
    ClockOffset,
    OffsetEstimate,
)
from crazychoir.bus.codec import encode
from crazychoir.errors import CodecError

SECOND = 1_000_000_000
NONSENSE = [
    None,
    [],
    [1, 2],
    [1, 2, 3, 4],
    [1.5],
    [True],
    ["1"],
    [-1],
    [1 << 62],
    [(1 << 64) - 1],
    [1000, 5, 4],
    [1000, 5, 5000],
    {"t": 1},
]


@dataclass
class Pair:
    """Asks another host: its clock is `skew` ns ahead of ours and gains `gain` ns a second; `now` is our time."""

    skew: int
    gain: float = 0.0
    now: int = 5 * SECOND
    offset: ClockOffset = field(default_factory=ClockOffset)

    def theirs(self, ns: int) -> int:
        return ns + self.skew + round(self.gain * ns / SECOND)

    def ask(self, there: float, held: float, back: float) -> None:
        """A question and its answer, with the s that they take."""
        question = self.offset.ask(self.now)
        arrives = self.now + round(there * SECOND)
        leaves = arrives + round(held * SECOND)
        answer = ClockOffset().hear(question, self.theirs(arrives), self.theirs(leaves))
        self.now = leaves + round(back * SECOND)
        assert self.offset.hear(answer, self.now, self.now) is None

    def wait(self, seconds: float) -> None:
        self.now += round(seconds * SECOND)

    def found(self) -> OffsetEstimate:
        return self.offset.estimate(self.now)

    def wrong(self) -> float:
        """s, of the estimate now."""
        return abs(self.found().offset - (self.theirs(self.now) - self.now) / SECOND)


def test_a_symmetric_way_shows_the_offset_whatever_the_answer_waited():
    pair = Pair(skew=1000 * SECOND)
    pair.ask(0.002, 0.5, 0.002)
    assert pair.found() == pytest.approx((1000.0, 0.002), abs=1e-9)


@pytest.mark.parametrize("ways", [(0.0, 0.01), (0.01, 0.0)])
def test_a_way_in_one_direction_alone_is_as_wrong_as_the_error_says_and_no_more(ways):
    pair = Pair(skew=-3 * SECOND)
    pair.ask(ways[0], 0.1, ways[1])
    assert pair.wrong() == pytest.approx(pair.found().error, abs=1e-9)
    assert pair.found().error == pytest.approx(0.005)


def test_the_estimate_is_within_its_error_over_ways_that_differ_and_clocks_that_drift():
    """Ten minutes of ways of 0.2 to 20 ms, in both directions apart."""
    chance = np.random.default_rng(3)
    for gain in (-CLOCK_DRIFT, 0.0, 0.99 * CLOCK_DRIFT):
        pair = Pair(skew=1000 * SECOND, gain=gain * SECOND)
        for _ in range(600):
            pair.ask(*(0.0002 + 0.02 * chance.random() ** 4 for _ in range(3)))
            assert pair.wrong() <= pair.found().error + 2e-9
            pair.wait(1.0)
            assert pair.wrong() <= pair.found().error + 2e-9
        assert pair.found().error < 0.001, "a shorter way than most"


def test_the_shortest_way_counts_until_its_age_outweighs_it_or_it_is_forgotten():
    pair = Pair(skew=0)
    pair.ask(0.001, 0.0, 0.001)
    for _ in range(OFFSET_SAMPLES - 1):
        pair.wait(1.0)
        pair.ask(0.05, 0.0, 0.03)
        assert pair.found().offset == pytest.approx(0.0, abs=1e-9)
    assert pair.found().error == pytest.approx(
        0.001 + CLOCK_DRIFT * pair.now / SECOND, abs=2e-4
    )
    pair.ask(0.05, 0.0, 0.03)
    assert pair.found().offset == pytest.approx(0.01, abs=1e-9), (
        "it was the oldest of too many"
    )


def test_another_clock_is_noticed_at_its_first_answer():
    """A host that was started anew, within the same seconds."""
    pair = Pair(skew=1000 * SECOND)
    pair.ask(0.0001, 0.0, 0.0001)
    pair.skew = 7 * SECOND
    pair.ask(0.01, 0.0, 0.012)
    assert pair.found() == pytest.approx((6.999, 0.011), abs=1e-9)


def test_late_repeated_and_unasked_answers_do_not_count():
    pair = Pair(skew=0)
    late = ClockOffset().hear(pair.offset.ask(100), 200, 200)
    question = pair.offset.ask(1000)
    pair.offset.hear(late, 1400, 1400)
    assert pair.offset.estimate(1400) is None
    answer = ClockOffset().hear(question, 1100, 1100)
    pair.offset.hear(answer, 1200, 1200)
    pair.offset.hear(answer, 9000, 9000)
    pair.offset.hear(encode([1, 2, 2]), 9000, 9000)
    assert pair.offset.estimate(1200) == OffsetEstimate(0.0, 1e-7)


@pytest.mark.parametrize("said", NONSENSE)
def test_what_is_neither_question_nor_answer_is_refused_and_changes_nothing(said):
    offset = ClockOffset()
    question = offset.ask(1000)
    with pytest.raises(CodecError):
        offset.hear(encode(said), 2000, 2000)
    with pytest.raises(CodecError):
        offset.hear(b"\xff", 2000, 2000)
    assert offset.estimate(2000) is None
    offset.hear(ClockOffset().hear(question, 50, 50), 2000, 2000)
    assert offset.estimate(2000) is not None
