from crazychoir.bus.frames import FRAME_FORMAT
from crazychoir.bus.network.flood_limit import (
    FLOOD_LIMITS,
    FrameBudget,
    FrameBudgets,
)
from crazychoir.runtime.clock import NS_PER_SECOND


def test_a_burst_is_let_through_and_then_so_many_a_second():
    budget = FrameBudget(0)
    assert (
        sum(budget.take(0) for _ in range(2 * int(FLOOD_LIMITS.burst_size)))
        == FLOOD_LIMITS.burst_size
    )
    step = NS_PER_SECOND // 100_000  # a flood of 100 000 frames/s
    passed = sum(budget.take(k * step) for k in range(1, 100_001))
    assert abs(passed - FLOOD_LIMITS.frame_rate) <= 1
    assert budget.take(10 * NS_PER_SECOND)
    assert budget.left == FLOOD_LIMITS.burst_size - 1, "it does not grow beyond a burst"


def test_large_frames_count_as_several():
    budget = FrameBudget(0)
    passed = sum(budget.take(0, 8 << 20) for _ in range(int(FLOOD_LIMITS.burst_size)))
    assert passed * (8 << 20) <= FLOOD_LIMITS.burst_size * FLOOD_LIMITS.frame_part
    assert FrameBudget(0).take(0, FRAME_FORMAT.max_bytes)


def test_a_sender_at_the_allowed_rate_loses_nothing():
    budget, step = FrameBudget(0), int(NS_PER_SECOND / FLOOD_LIMITS.frame_rate) + 1
    assert all(budget.take(k * step) for k in range(50_000))


def test_each_host_has_its_own_and_forged_names_share_one():
    budgets = FrameBudgets()
    flooded = budgets.of("a", 0)
    while flooded.take(0):
        pass
    assert budgets.of("a", 0) is flooded
    assert budgets.of("b", 0).take(0)
    made = [budgets.of(f"h{k}", 0) for k in range(3 * FLOOD_LIMITS.max_hosts)]
    assert len({id(one) for one in made}) <= FLOOD_LIMITS.max_hosts
