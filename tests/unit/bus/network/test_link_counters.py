"""The counts of a link that the operator sees."""

from crazychoir.bus.network.link_counters import FAULT_TEXTS, LinkCounters


def test_only_faults_that_have_happened_are_listed():
    counters = LinkCounters(frames_sent=9, strangers=2, flooded=3, full=1)
    full = f"{FAULT_TEXTS['full']}: 1"
    flooded = "frames dropped, because a host sends too many: 3"
    assert counters.list_faults() == [full, flooded]
    counters.broken = 4
    counters.overtaken = 5
    broken = "connections broken: 4"
    overtaken = "control messages overtaken by newer ones: 5"
    assert counters.list_faults() == [full, broken, overtaken, flooded]
    assert LinkCounters(frames_sent=9).list_faults() == []
