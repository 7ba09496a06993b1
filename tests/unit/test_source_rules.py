import pytest
from source_rules import CLOCKS, STOPWATCHES, forbidden_clocks, set_iterations


@pytest.mark.parametrize(
    "source",
    [
        "import time\nt = time.time()",
        "import time as t\nt.monotonic()",
        "from time import monotonic",
        "from time import time as now",
        "import time\nclock = time.time_ns",
        "import asyncio\nasync def f():\n    await asyncio.sleep(1)",
        "import asyncio as aio\naio.sleep(0)",
        "from asyncio import sleep",
        "from datetime import datetime\ndatetime.now()",
        "import datetime\ndatetime.datetime.utcnow()",
        "def f():\n    import time\n    return time.monotonic()",
    ],
)
def test_each_way_to_read_the_wall_clock_is_found(source):
    assert forbidden_clocks(source, CLOCKS)


@pytest.mark.parametrize(
    "source",
    [
        "import time\ntime.perf_counter()",
        "async def f(clock):\n    await clock.sleep(1)\n    return clock.time()",
        "class A:\n    time = 3\nA.time",
        "import asyncio\nasyncio.timeout(3)",
    ],
)
def test_other_clocks_pass(source):
    assert forbidden_clocks(source, CLOCKS) == []


def test_a_stopwatch_is_found():
    assert forbidden_clocks("import time\ntime.perf_counter_ns()", STOPWATCHES) == [
        "2: time.perf_counter_ns"
    ]


@pytest.mark.parametrize(
    "source",
    [
        "for x in {1, 2}: ...",
        "for x in set(y): ...",
        "for x in frozenset(y): ...",
        "[x for x in {a for a in b}]",
        "async def f():\n    async for x in set(y): ...",
        "s = {1}\nfor x in s: ...",
        "s = t = set()\nlist(t)",
        "a = b\nb = set()\nfor x in a: ...",
        "def f(s: set[int]):\n    return [x for x in s]",
        "def f(s: 'int', t: frozenset[int]):\n    return tuple(t)",
        "class A:\n    s: set[int]\n    def f(self):\n        for x in self.s: ...",
        "def f(self):\n    self.s = set()\ndef g(self):\n    for x in self.s | t: ...",
        "for x in a.keys() - b: ...",
        "for x in a.keys() & b.keys(): ...",
        "for x in a.union(b): ...",
        "if (s := set(a)):\n    ', '.join(s)",
        "[*{1, 2}]",
        "f(*{1, 2})",
        "{k: 1 for k in set(a)}",
        "sum(x for x in set(a))",
        "s = {1}\ns.pop()",
        "s = {1}\na, b = s",
        "dict.fromkeys({1, 2})",
        "for x in {1} if a else b: ...",
        "for i, x in enumerate(set(a)): ...",
    ],
)
def test_each_way_to_take_a_set_in_hash_order_is_found(source):
    assert set_iterations(source)


@pytest.mark.parametrize(
    "source",
    [
        "for x in sorted({1, 2}): ...",
        "for x in [1, 2]: ...",
        "for x in {1: 2}: ...",
        "for x in a.keys(): ...",
        "s = {1}\nlen(s), min(s), 3 in s, s.add(2), s - {1}",
        "for x in dict.fromkeys(a): ...",
        "for x in a - b: ...",
        "queue.pop()",
        "s = {1}\nt = {*s, 2} | {x + 1 for x in s}",
    ],
)
def test_what_has_an_order_passes(source):
    assert set_iterations(source) == []
