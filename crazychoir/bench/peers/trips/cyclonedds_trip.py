"""CycloneDDS: each drone writes a topic and reads that of the other one; a listener wakes uvloop.

The message is that of the exchange: two integers and six numbers, 56 bytes.
"""

import asyncio
import importlib
import os

from crazychoir.bench.peers.cyclonedds_peer import CYCLONEDDS_SETTINGS, Participant
from crazychoir.bench.peers.peers import specification
from crazychoir.bench.peers.trips.trip import run_drone


async def main() -> None:
    """Find the other, wait for go, and send messages there and back until killed."""
    spec = specification()
    participant = Participant(spec, asyncio.get_running_loop())
    own = spec["mine"][0]
    inbox = participant.inboxes[own]
    writer = participant.writers[own]
    participant.wait_until_matched()
    k = 0

    async def go_and_return() -> None:
        nonlocal k
        writer.write(participant.make_message(own, k))
        await inbox.get(k)
        k += 1

    async def answer() -> None:
        nonlocal k
        await inbox.get(k)
        writer.write(participant.make_message(own, k))
        k += 1

    await run_drone(spec, go_and_return, answer)


if __name__ == "__main__":
    os.environ["CYCLONEDDS_URI"] = CYCLONEDDS_SETTINGS
    importlib.import_module("uvloop").run(main())
