"""When a drone has found what it says, however late that comes."""

import pytest

from crazychoir.radio.uptime import DRONE_CLOCK, Uptime


def told(uptime, ats, now=lambda at: 50.0 + at / 1000 + 0.004):
    """Logs of these times, of its clock; when they come, by ours."""
    return [uptime.taken(now(at), at % DRONE_CLOCK.wrap_period) for at in ats]


def test_what_waited_was_so_when_it_was_so():
    uptime = Uptime()
    told(uptime, range(3000, 4000, 20))
    held = told(
        uptime, range(4000, 4900, 20), now=lambda at: 54.9 + 0.004 * (at - 4000) / 20
    )
    assert held == pytest.approx([54.004 + 0.02 * k for k in range(45)], abs=0.002)


def test_an_overtaken_packet_is_recognized_and_is_no_restart():
    uptime = Uptime()
    told(uptime, [*range(3000, 4000, 20), 4900])
    assert uptime.overtaken(4020)
    assert not uptime.restarted(54.95, 4020)
    assert not uptime.overtaken(4920)


def test_a_clock_that_runs_fast_or_slow_is_followed():
    for share in (0.9995, 1.0005):
        uptime = Uptime()
        (*_, last) = told(
            uptime,
            range(0, 600_000, 50),
            now=lambda at, share=share: 5.0 + share * at / 1000,
        )
        assert last == pytest.approx(5.0 + share * 599.95, abs=0.001)


def test_a_time_that_begins_anew_goes_on():
    uptime = Uptime()
    ats = range(DRONE_CLOCK.wrap_period - 100, DRONE_CLOCK.wrap_period + 100, 20)
    assert told(uptime, ats) == pytest.approx(
        [50.0 + at / 1000 + 0.004 for at in ats], abs=1e-3
    )
    assert not uptime.restarted(50.0 + (DRONE_CLOCK.wrap_period + 120) / 1000, 120)


@pytest.mark.parametrize("hours", [0.0, 1.0, 2.4, 3.0, 4.5, 4.66])
def test_however_long_it_has_been_on_it_is_heard_from_its_first_log_on(hours):
    uptime, began = Uptime(), round(3_600_000 * hours)
    for at in range(began, began + 2000, 20):
        now = 7.0 + (at - began) / 1000
        assert not uptime.restarted(now, at % DRONE_CLOCK.wrap_period)
        assert not uptime.overtaken(at % DRONE_CLOCK.wrap_period)
        assert uptime.taken(now, at % DRONE_CLOCK.wrap_period) == pytest.approx(
            now, abs=1e-3
        )


@pytest.mark.parametrize(
    ("up", "silent"), [(3600.0 * 3.0, 3.0), (3600.0 * 4.6, 30.0), (4.0, 60.0)]
)
def test_a_restart_is_recognized_at_any_earlier_uptime(up, silent):
    uptime = Uptime()
    told(uptime, [round(1000 * up)], now=lambda at: 50.0)
    assert not uptime.restarted(
        50.0 + silent, round(1000 * (up + silent)) % DRONE_CLOCK.wrap_period
    )
    assert uptime.restarted(50.0 + silent, 5000)


@pytest.mark.parametrize(("up", "silent"), [(60.0, 3.0), (2.0, 1.0)])
def test_a_restarted_drone_is_younger_than_its_last_message(up, silent):
    uptime = Uptime()
    told(uptime, [round(1000 * up)])
    assert uptime.restarted(50.004 + up + silent, round(1000 * (silent - 0.5)))
