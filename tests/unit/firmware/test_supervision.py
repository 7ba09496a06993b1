"""States and bits of the supervisor, and times that the radio keeps, are those of the firmware."""

from crazychoir.firmware.memories import TRAJECTORY_MEMORY
from crazychoir.firmware.supervision import (
    STATE_NAMES,
    SUPERVISOR_BITS,
    SUPERVISOR_STATES,
)
from crazychoir.firmware.timeouts import FIRMWARE_TIMEOUTS
from crazychoir.radio.drone.timing import REPEAT_RULES, SILENCE_LIMITS


def test_each_state_has_its_number_and_a_name():
    assert tuple(range(len(STATE_NAMES))) == SUPERVISOR_STATES


def test_each_bit_stands_alone_at_its_place():
    assert tuple(1 << place for place in range(12)) == SUPERVISOR_BITS


def test_an_owner_feeds_the_watchdog_in_time_and_sees_dropped_logs_when_they_are():
    assert REPEAT_RULES.watchdog_period == 0.25 * 1e-3 * FIRMWARE_TIMEOUTS.watchdog
    assert SILENCE_LIMITS.logs_dropped == 1e-3 * FIRMWARE_TIMEOUTS.link_silence


def test_the_pieces_that_are_told_fit_into_the_memory_for_trajectories():
    piece = 4 * TRAJECTORY_MEMORY.piece_size
    room = TRAJECTORY_MEMORY.byte_count
    assert TRAJECTORY_MEMORY.size == room // 4
    assert TRAJECTORY_MEMORY.most_pieces == room // piece
