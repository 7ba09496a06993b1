"""TaskBook: news merge in any order; what has become of a task follows from what the robots have done."""

from itertools import permutations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.bus.codec import decode, encode
from crazychoir.errors import CodecError
from crazychoir.guidance.tasks.task_book import (
    Deed,
    Fate,
    Record,
    Task,
    TaskBook,
    TaskState,
)

PICK, DROP = "pickup", "delivery"
places = st.tuples(st.integers(-3, 3).map(float), st.integers(-3, 3).map(float))
tasks = st.builds(
    Task,
    id=st.integers(0, 3),
    version=st.integers(0, 2),
    cancelled=st.booleans(),
    pickup=places,
    delivery=places,
)
deeds = st.lists(
    st.builds(
        Deed, st.integers(0, 3), st.sampled_from([PICK, DROP]), st.integers(1, 2)
    ),
    max_size=3,
)
records = st.builds(
    Record,
    robot=st.integers(0, 2),
    incarnation=st.integers(1, 2),
    number=st.integers(1, 3),
    place=places,
    deeds=deeds.map(tuple),
    out=st.booleans(),
    life=st.integers(1, 2),
)
books = st.builds(TaskBook, st.lists(tasks, max_size=4), st.lists(records, max_size=5))

TEAMS = (0, 1, 2), (0,), ()


def content(book):
    return (
        book.tasks,
        book.records,
        {i: book.newest(i) for i in range(3)},
        *(book.standings(m, True) for m in TEAMS),
    )


def merged(*parts):
    """Asked in between: what it has answered once must not stay."""
    book = TaskBook()
    for part in parts:
        book.merge(part)
        content(book)
    return book


@given(books, books, books)
def test_merging_is_commutative_associative_and_idempotent(a, b, c):
    whole = content(merged(a, b, c))
    for order in permutations((a, b, c)):
        assert content(merged(*order)) == whole
    assert content(merged(a, merged(b, c))) == content(merged(merged(a, b), c)) == whole
    again = merged(a, b, c)
    assert not again.merge(merged(b, a))
    assert content(again) == whole


@given(books)
def test_a_book_travels_whole(book):
    assert content(TaskBook.of(decode(encode(book.wire())))) == content(book)


@given(books, books)
def test_the_tasks_may_stay_behind_where_they_are_known(a, b):
    a.merge(b)
    b.merge(TaskBook(a.tasks.values()))
    assert a.checksum == b.checksum
    assert content(merged(b, TaskBook.of(a.wire(tasks=False)))) == content(merged(a, b))


@given(books, books)
def test_other_tasks_have_another_checksum(a, b):
    assert (a.checksum == b.checksum) == (a.tasks == b.tasks)


@pytest.mark.parametrize(
    "wire",
    [
        b"",
        b"nonsense",
        None,
        [],
        3,
        "text",
        b"\x92\x90\x90 and more",
        b"\xc1" * 40,
        b"\x91" * 5000,
    ],
)
def test_what_is_no_book_is_refused(wire):
    with pytest.raises(CodecError, match="task book"):
        TaskBook.of(wire)


@pytest.mark.parametrize(
    "place", [(float("nan"), 0.0), (float("inf"), 0.0), (1e9, 0.0)]
)
def test_a_place_that_is_none_is_refused(place):
    with pytest.raises(CodecError):
        TaskBook.of(TaskBook([Task(0, 0, False, place, (0.0, 0.0))]).wire())


# What has become of a task ------------------------------------------------------------------------------------

TASK = Task(7, 1, False, (1.0, 2.0), (3.0, 4.0))


def record(i, *done, **changes):
    return Record(
        i,
        1,
        1,
        (float(i), -1.0),
        tuple(Deed(7, kind, n) for kind, n in done),
        **changes,
    )


@pytest.mark.parametrize(
    ("said", "lost", "recovered"),
    [
        ([], TaskState(Fate.OPEN, (1, 2)), None),
        ([record(0, (PICK, 1))], TaskState(Fate.ABOARD, (1, 2), 0, 1), None),
        ([record(0, (PICK, 1), (DROP, 1))], TaskState(Fate.DELIVERED, (1, 2), 0), None),
        # 5 is no member
        (
            [record(5, (PICK, 1))],
            TaskState(Fate.LOST, (1, 2), 5, 1),
            TaskState(Fate.OPEN, (5, -1), 5, 1),
        ),
        (
            [record(0, (PICK, 1), out=True)],
            TaskState(Fate.LOST, (1, 2), 0, 1),
            TaskState(Fate.OPEN, (0, -1), 0, 1),
        ),
        ([record(5, (PICK, 1), (DROP, 1))], TaskState(Fate.DELIVERED, (1, 2), 5), None),
        (
            [record(5, (PICK, 1)), record(1, (PICK, 2))],
            TaskState(Fate.ABOARD, (1, 2), 1, 2),
            None,
        ),
        (
            [record(0, (PICK, 1)), record(1, (PICK, 2))],
            TaskState(Fate.ABOARD, (1, 2), 1, 2),
            None,
        ),
        (
            [record(0, (PICK, 1)), record(1, (PICK, 1))],
            TaskState(Fate.ABOARD, (1, 2), 0, 1),
            None,
        ),
    ],
)
def test_a_task_is_where_the_last_robot_that_picked_it_up_is(said, lost, recovered):
    book = TaskBook([TASK], said)
    assert book.standings((0, 1, 2), recover=False) == {7: lost}
    assert book.standings((0, 1, 2), recover=True) == {7: recovered or lost}


def test_a_robot_that_was_started_again_has_lost_what_it_carried():
    book = TaskBook([TASK], [record(0, (PICK, 1)), Record(0, 2, 1, (9.0, 9.0))])
    assert book.standings((0, 1), recover=False)[7].fate is Fate.LOST
    assert book.standings((0, 1), recover=True)[7] == TaskState(
        Fate.OPEN, (0, -1), 0, 1
    )
    assert book.newest(0).incarnation == 2


def test_the_later_life_of_a_robot_counts_whatever_its_random_incarnation():
    """A team that ignores the lower incarnation never ends, and the goods of the robot belong to no robot."""
    before, after = record(0, (PICK, 1)), Record(0, 0, 1, (9.0, 9.0))
    second = replace(after, life=2)
    for order in (
        (before, second),
        (second, before),
        (before, after, replace(after, 2)),
    ):
        book = TaskBook([TASK], order)
        book.standings((0, 1), recover=True)
        book.hear(replace(after, number=3, life=2))
        assert book.newest(0).incarnation == 0
        assert book.standings((0, 1), recover=True)[7].fate is Fate.OPEN
        assert list(book.alive((0, 1))) == [0]


def replace(record, number=1, life=1):
    return msgspec.structs.replace(record, number=number, life=life)


def test_a_cancelled_task_that_is_aboard_is_still_delivered():
    book = TaskBook([TASK], [record(0, (PICK, 1))])
    assert book.cancel(7)
    assert not book.cancel(7)
    assert book.standings((0,), recover=False)[7].fate is Fate.ABOARD
    assert book.standings((1,), recover=True)[7].fate is Fate.CANCELLED
    assert (
        TaskBook([book.tasks[7]]).standings((0,), recover=False)[7].fate
        is Fate.CANCELLED
    )


def test_a_higher_version_of_a_task_replaces_a_cancelled_one():
    book = TaskBook([TASK])
    book.cancel(7)
    newer = Task(7, 2, False, (0.0, 0.0), (3.0, 4.0))
    assert book.learn(newer)
    assert not book.learn(TASK)
    assert book.tasks[7] == newer


def test_witnesses_are_the_robots_known_to_have_heard_the_record():
    heard = [((0, 1, 4),), ((0, 1, 5),), ((0, 2, 9),), ((0, 1, 6), (2, 1, 1))]
    book = TaskBook(
        [], [Record(j + 1, 1, 1, (0.0, 0.0), (), seen) for j, seen in enumerate(heard)]
    )
    book.hear(Record(0, 1, 6, (0.0, 0.0)))
    everybody = (0, 1, 2, 3, 4)
    assert [book.witnesses(0, 1, n, everybody) for n in (4, 5, 6, 7)] == [3, 2, 1, 0]
    assert book.witnesses(0, 1, 5, (0, 1, 2)) == 1, "only members count"
    book.hear(Record(4, 1, 2, (0.0, 0.0), (), heard[3], out=True))
    assert book.witnesses(0, 1, 5, everybody) == 1, "robot 4 is out and does not count"


def test_goods_are_where_a_robot_that_is_out_says_that_it_is_now():
    book = TaskBook([TASK], [record(0, (PICK, 1))])
    for number, place in ((2, (0.5, 0.5)), (3, (0.25, 0.0))):
        assert book.standings((0,), recover=True)[7].generation == 1
        book.hear(Record(0, 1, number, place, (Deed(7, PICK, 1),), out=True))
        assert book.standings((0,), recover=True)[7] == TaskState(
            Fate.OPEN, place, 0, 1
        )


def test_goods_stay_at_the_last_place_of_a_lost_robot_in_any_order_of_records():
    """The last record of the robot says where its goods lie, also if it is heard after its loss was noticed."""
    last, before = (
        Record(1, 1, n, place, (Deed(7, PICK, 1),))
        for n, place in ((9, (3.0, 3.0)), (4, (1.0, 1.0)))
    )
    for order in permutations((before, last)):
        book = TaskBook([TASK])
        for said in order:
            book.hear(said)
            book.standings((0,), recover=True)
        assert book.standings((0,), recover=True)[7] == TaskState(
            Fate.OPEN, (3.0, 3.0), 1, 1
        )


def test_where_a_robot_flies_changes_nothing():
    """All robots say their places all the time: a new place must not cause a new look at all tasks."""
    book = TaskBook([TASK], [record(0, (PICK, 1)), record(1)])
    book.standings((0, 1), recover=True)
    before = book.changes
    assert book.hear(Record(0, 1, 2, (0.5, 0.5), (Deed(7, PICK, 1),)))
    assert book.hear(Record(1, 1, 2, (0.5, 0.5)))
    assert book.changes == before


@given(books, books)
def test_standings_follow_every_change(a, b):
    a.standings((0, 1), True)
    a.merge(b)
    assert a.standings((0, 1), True) == TaskBook(
        a.tasks.values(), a.records.values()
    ).standings((0, 1), True)
