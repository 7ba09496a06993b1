"""attempt: work that raises anywhere ends everywhere, in the same round, with the same word."""

from itertools import count

import pytest

from crazychoir.bus.codec import decode, encode
from crazychoir.errors import Hung, SolverError
from crazychoir.guidance.tasks.attempt import attempt_work

N, ROUNDS = 5, 6
PATH = {i: [j for j in (i - 1, i + 1) if 0 <= j < N] for i in range(N)}


def work(i, fails):
    """Sums up what it hears, for ROUNDS rounds; raises once the round `fails[i]` has been heard, 0: before any."""
    total = i
    for k in range(ROUNDS):
        if fails.get(i) == k:
            raise SolverError(f"solver {i}", "broken")
        heard = yield total
        total += sum(heard.values())
    if fails.get(i) == ROUNDS:
        raise ValueError("at the very end")
    return total


def run(fails, damage=lambda i, k, message: message, of=work):
    """What each robot of a path gets, and in which round."""
    programs, messages, ended = (
        {i: attempt_work(i, of(i, fails), N - 1) for i in PATH},
        {},
        {},
    )
    heard = dict.fromkeys(PATH)
    for k in count():
        for i, program in programs.items():
            try:
                messages[i] = damage(i, k, decode(encode(program.send(heard[i]))))
            except StopIteration as end:
                ended[i] = k, *end.value
        if ended:
            return ended
        heard = {i: {j: messages[j] for j in PATH[i]} for i in PATH}
    raise AssertionError


def test_work_that_raises_nowhere_returns_what_it_would_alone():
    ended = run({})
    assert [k for k, _, _ in ended.values()] == [ROUNDS + N - 1] * N
    assert [why for _, _, why in ended.values()] == [""] * N
    totals = list(PATH)
    for _ in range(ROUNDS):
        totals = [totals[i] + sum(totals[j] for j in PATH[i]) for i in PATH]
    assert [total for _, total, _ in ended.values()] == totals


@pytest.mark.parametrize("first", range(ROUNDS + 1))
@pytest.mark.parametrize(
    "more", [{}, {4: 6}, {4: 4, 1: 5}, {2: 3}, {i: 2 for i in PATH}]
)
def test_where_one_raises_all_end_in_one_round_with_the_word_of_the_first(first, more):
    fails = {0: first} | more
    k, i = min((k, i) for i, k in fails.items())
    ended = run(fails)
    assert len(ended) == N
    assert {(end, found) for end, found, _ in ended.values()} == {(k + N - 1, None)}
    (why,) = {why for _, _, why in ended.values()}
    said = f"SolverError: solver {i}: the solver ended with status broken"
    assert why.startswith(
        f"robot {i}: "
        + (said if k < ROUNDS else "ValueError: at the very end (test_attempt.py:")
    )


@pytest.mark.parametrize(
    "nonsense",
    [None, 7, [], [1, 2], [9, 1, "later"], [-1, 1, ""], ["x", 1, ""], {}, "abc"],
)
def test_what_is_no_message_is_a_failure_too(nonsense):
    ended = run({}, lambda i, k, message: nonsense if (i, k) == (2, 3) else message)
    assert {end for end, _, _ in ended.values()} == {4 + N - 1}
    assert {why for _, _, why in ended.values()} == {
        "robot 1: CodecError: from robot 2, round 3: neither a message nor a failure report"
    }


def test_code_that_the_watchdog_has_interrupted_is_not_tried_any_other_way():
    def hangs(i, fails):
        raise Hung("too long")
        yield

    with pytest.raises(Hung):
        run({}, of=hangs)
