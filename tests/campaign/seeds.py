"""From a seed to its scenario: of twenty seeds three fly."""

import gc
import logging
import signal
import time
from typing import Any

import numpy as np

from campaign import flights, ground
from campaign.report import LIGHTWEIGHT, Report

PATIENCE = 120
"""s of the processor after which a scenario hangs; of the wall clock ten times as many, if others use the processor."""
KINDS = {**ground.KINDS, **flights.KINDS}


class Hangs(KeyboardInterrupt):
    """A scenario takes too long. No Exception: event loops and supervisors go on after those."""


def kind_of(seed: int) -> str:
    """What a seed is a scenario of."""
    number, rest = divmod(seed, 20)
    if rest >= 17:
        return list(flights.KINDS)[rest - 17]
    return list(ground.KINDS)[(17 * number + rest) % len(ground.KINDS)]


def run(seed: int, world: str = LIGHTWEIGHT) -> Report:
    """The scenario of a seed, flown in a world; what it raises is an invariant that does not hold."""
    kind = kind_of(seed)
    report = Report(seed, kind, world)
    try:
        KINDS[kind](report, np.random.default_rng([seed, 8]))
    except (Exception, Hangs) as error:  # noqa: BLE001 - it is the campaign's finding
        report.wrong.append(f"{type(error).__name__}: {error}")
    return report


def quiet() -> None:
    """What drones say in all their trouble is not for this terminal.

    The garbage collector ignores what is loaded now.
    """
    gc.freeze()
    logging.disable(logging.CRITICAL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def late(number: int, frame: Any) -> None:
    """The alarm."""
    raise Hangs(
        f"{PATIENCE:g} s of the processor, or {10 * PATIENCE:g} of the wall clock"
    )


def timed(chosen: tuple[int, str]) -> tuple[Report, float]:
    """The scenario of a seed, flown in a world, and s of its processor."""
    for alarm in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(alarm, late)
    signal.setitimer(signal.ITIMER_PROF, PATIENCE)
    signal.alarm(10 * PATIENCE)
    began = time.process_time()
    try:
        return run(*chosen), time.process_time() - began
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.alarm(0)
