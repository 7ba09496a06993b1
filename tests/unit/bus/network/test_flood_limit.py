from crazychoir.bus.frames import MAX_FRAME
from crazychoir.bus.network.flood_limit import (
    BURST,
    MAX_HOSTS,
    PART,
    RATE,
    Budget,
    Budgets,
)
from crazychoir.runtime.clock import SECOND


def test_a_burst_is_let_through_and_then_so_many_a_second():
    budget = Budget(0)
    assert sum(budget.take(0) for _ in range(2 * int(BURST))) == BURST
    step = SECOND // 100_000  # a flood of 100 000 frames/s
    passed = sum(budget.take(k * step) for k in range(1, 100_001))
    assert abs(passed - RATE) <= 1
    assert budget.take(10 * SECOND)
    assert budget.left == BURST - 1, "it does not grow beyond a burst"


def test_large_frames_count_as_several():
    budget = Budget(0)
    passed = sum(budget.take(0, 8 << 20) for _ in range(int(BURST)))
    assert passed * (8 << 20) <= BURST * PART
    assert Budget(0).take(0, MAX_FRAME)


def test_who_sends_as_much_as_he_may_loses_nothing():
    budget, step = Budget(0), int(SECOND / RATE) + 1
    assert all(budget.take(k * step) for k in range(50_000))


def test_each_host_has_its_own_and_forged_names_share_one():
    budgets = Budgets()
    flooded = budgets.of("a", 0)
    while flooded.take(0):
        pass
    assert budgets.of("a", 0) is flooded
    assert budgets.of("b", 0).take(0)
    made = [budgets.of(f"h{k}", 0) for k in range(3 * MAX_HOSTS)]
    assert len({id(one) for one in made}) <= MAX_HOSTS
