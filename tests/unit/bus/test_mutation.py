import tracemalloc
from pathlib import Path

import msgspec
import pytest
from unit.bus.mutation import campaign, frames, mutants, payloads

from crazychoir.errors import CodecError

MB = 1 << 20


def resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def run(count, seed):
    campaign(1000, seed)
    before = resident()
    seen = campaign(count, seed)
    assert resident() - before < 64 * MB
    assert sum(seen.values()) >= count
    return seen


def test_only_codec_errors_escape_and_memory_stays():
    seen = run(50_000, 1)
    assert min(seen.values()) > 5000, seen


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_only_codec_errors_escape_in_a_million():
    run(1_000_000, 2)


def test_no_mutant_costs_much_memory():
    tracemalloc.start()
    try:
        campaign(3000, 3)
        assert tracemalloc.get_traced_memory()[1] < 8 * MB
    finally:
        tracemalloc.stop()


def unguarded(payload):
    return msgspec.msgpack.decode(payload[1:], ext_hook=lambda code, data: None)


def test_the_campaign_finds_a_decoder_that_leaks_other_errors():
    with pytest.raises((msgspec.DecodeError, UnicodeDecodeError, RecursionError)):
        campaign(2000, 1, unguarded)


def test_the_campaign_finds_a_decoder_that_lets_strange_values_in():
    def lenient(payload):
        try:
            return unguarded(payload)
        except (ValueError, TypeError, RecursionError):
            raise CodecError from None

    with pytest.raises(CodecError, match=r"datetime|more than is allowed"):
        campaign(50_000, 1, lenient)


def test_mutants_are_a_function_of_the_seed():
    assert list(mutants(frames(), 50, 7)) == list(mutants(frames(), 50, 7))
    assert list(mutants(payloads(), 50, 7)) != list(mutants(payloads(), 50, 8))
