"""CycloneDDS: each drone writes a topic and reads that of the other one; a listener wakes uvloop.

The message is that of the exchange: two integers and six numbers, 56 bytes.
"""

import asyncio
import importlib
import os

from crazychoir.bench.peers.cyclonedds_peer import CYCLONEDDS_SETTINGS, Participant
from crazychoir.bench.peers.peers import say, specification, wait_for_go
from crazychoir.bench.peers.trips.trip import answer_later, ask_for_window, is_asking


async def main() -> None:
    """Find the other, wait for go, and send messages there and back until killed."""
    spec = specification()
    participant = Participant(spec, asyncio.get_running_loop())
    own = spec["mine"][0]
    inbox = participant.inboxes[own]
    writer = participant.writers[own]
    participant.wait_until_matched()
    say({"ready": True})
    await asyncio.to_thread(wait_for_go)
    k = 0

    async def go_and_return() -> None:
        nonlocal k
        writer.write(participant.make_message(own, k))
        await inbox.get(k)
        k += 1

    if is_asking(spec):
        await ask_for_window(spec, go_and_return)
    answer_later(spec)
    while True:
        await inbox.get(k)
        writer.write(participant.make_message(own, k))
        k += 1


if __name__ == "__main__":
    os.environ["CYCLONEDDS_URI"] = CYCLONEDDS_SETTINGS
    importlib.import_module("uvloop").run(main())
