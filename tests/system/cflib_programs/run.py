"""Run all programs at once, each with a drone of its own; print one JSON object: what each has ended with."""

import json
import sys
import tempfile
import threading
import time
import traceback

import cflib.crtp
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie

from cflib_programs import basics, ends, flights, swarms

CHAINS = 3
"""Drones that serve the programs that do not fly, one after the other."""
PROGRAMS = (
    *((program,) for program in (*flights.PROGRAMS, *ends.PROGRAMS)),
    *(basics.PROGRAMS[k::CHAINS] for k in range(CHAINS)),
)
"""Programs of one drone each."""


def main(first):
    """first: the port of the first drone."""
    cflib.crtp.init_drivers()
    uris = [f"udp://127.0.0.1:{first + k}" for k in range(len(PROGRAMS) + 3)]
    results = {}
    with tempfile.TemporaryDirectory() as cache:
        with SyncCrazyflie(uris[-1], cf=Crazyflie(rw_cache=cache)):
            pass  # the cache is not made for many programs that fill it at once
        threads = [
            threading.Thread(
                target=_run, args=(programs, where, cache, results), daemon=True
            )
            for programs, where in [
                *zip(PROGRAMS, uris, strict=False),
                ((swarms.three,), uris[-3:]),
            ]
        ]
        for thread in threads:
            thread.start()
            time.sleep(0.02)
        for thread in threads:
            thread.join(90)
    sys.__stdout__.write(json.dumps(results) + "\n")


def _run(programs, uri, cache, results):
    for program in programs:
        results[program.__name__] = "did not end"
        try:
            program(uri, cache)
            results[program.__name__] = ""
        except Exception:  # noqa: BLE001 - whatever it ends with is the result
            results[program.__name__] = traceback.format_exc()


if __name__ == "__main__":
    sys.stdout, first = sys.stderr, int(sys.argv[1])  # cflib prints
    main(first)
    sys.__stdout__.flush()
