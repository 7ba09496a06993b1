"""The counts of a link that the operator sees."""

from crazychoir.bus.network.link_counters import LinkCounters


def test_only_faults_that_have_happened_are_listed():
    counters = LinkCounters(frames_sent=9, strangers=2, flooded=3, full=1)
    assert counters.list_faults() == ["full 1", "flooded 3"]
    counters.broken = 4
    counters.overtaken = 5
    assert counters.list_faults() == ["full 1", "broken 4", "overtaken 5", "flooded 3"]
    assert LinkCounters(frames_sent=9).list_faults() == []
