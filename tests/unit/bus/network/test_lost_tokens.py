"""Lost tokens of processes: which processes to greet, and when to declare another token."""

import pytest

from crazychoir.bus.network.lost_tokens import LOST_TOKEN_LIMITS, TokenRepair
from crazychoir.bus.network.peers import PEER_LIMITS


def count_greeting(estranged: TokenRepair, process: str) -> bool:
    """Let a HELLO without our token arrive in a tick of its own; return whether to declare another."""
    estranged.due(gone_too=False)
    return estranged.missed(process)


@pytest.fixture
def estranged() -> TokenRepair:
    return TokenRepair()


def test_a_stranger_is_answered_once_for_all_of_its_frames(
    estranged: TokenRepair,
) -> None:
    for _ in range(3):
        estranged.heard("b")
    assert estranged.due(gone_too=False) == ["b"]
    assert estranged.due(gone_too=True) == []


def test_a_peer_that_went_is_greeted_until_it_comes_back(
    estranged: TokenRepair,
) -> None:
    estranged.went("b")
    estranged.heard("b")
    assert estranged.due(gone_too=True) == ["b"], "once, not twice"
    assert estranged.due(gone_too=False) == []
    assert estranged.due(gone_too=True) == ["b"]
    estranged.heard("b")
    estranged.came("b")
    assert estranged.due(gone_too=True) == []


def test_another_token_after_four_greetings_without_us_and_then_ever_more_seldom(
    estranged: TokenRepair,
) -> None:
    declared = [k for k in range(1, 70) if count_greeting(estranged, "b")]
    assert declared == [4, 8, 16, 32, 64]


def test_many_greetings_at_once_count_as_one(estranged: TokenRepair) -> None:
    for _ in range(LOST_TOKEN_LIMITS.patience - 1):
        estranged.due(gone_too=False)
        assert not any(estranged.missed("b") for _ in range(9))
    assert count_greeting(estranged, "b")


def test_one_token_is_declared_for_all_that_miss_it_at_once(
    estranged: TokenRepair,
) -> None:
    declared = []
    for _ in range(8):
        estranged.due(gone_too=False)
        found = [estranged.missed(process) for process in "bcd"]
        declared.append(found)
    none = [False] * 3
    first = [True, False, False]
    assert declared == [*[none] * 3, first, *[none] * 3, first]


@pytest.mark.parametrize("known", [lambda e: e.known("b"), lambda e: e.went("b")])
def test_the_count_restarts_when_the_peer_knows_us_or_goes(
    estranged: TokenRepair, known
) -> None:
    for _ in range(3):
        assert not count_greeting(estranged, "b")
    known(estranged)
    assert [count_greeting(estranged, "b") for _ in range(4)] == [
        False,
        False,
        False,
        True,
    ]


def test_however_many_there_are_a_bound_is_kept(estranged: TokenRepair) -> None:
    many = [f"p{k}" for k in range(2 * PEER_LIMITS.max_peers)]
    for process in many:
        estranged.went(process)
        estranged.heard(process)
    assert (
        estranged.due(gone_too=True)
        == many[: LOST_TOKEN_LIMITS.answered_strangers]
        + many[-LOST_TOKEN_LIMITS.departed_processes :]
    )
    answered = [
        estranged.due(gone_too=False)
        for _ in range(PEER_LIMITS.max_peers // LOST_TOKEN_LIMITS.answered_strangers)
    ]
    assert [len(some) for some in answered] == [
        LOST_TOKEN_LIMITS.answered_strangers
    ] * (PEER_LIMITS.max_peers // LOST_TOKEN_LIMITS.answered_strangers - 1) + [0]
    for process in many:
        count_greeting(estranged, process)
    for _ in range(2):
        count_greeting(estranged, many[0])
        count_greeting(
            estranged,
            many[-1],
        )
    assert count_greeting(estranged, many[0])
    assert not count_greeting(
        estranged,
        many[-1],
    )
