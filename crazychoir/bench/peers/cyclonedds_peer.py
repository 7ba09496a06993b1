"""CycloneDDS: each agent writes a topic and reads those of its neighbours, as ROS 2 nodes do.

A listener wakes uvloop. The topics are reliable and keep the last 16 values. Discovery is by
unicast on the loopback interface.
"""

import asyncio
import dataclasses
import importlib
import os
import time
import types
from collections import deque
from typing import Any

from crazychoir.bench.peers.peers import report, say, specification, wait_for_go
from crazychoir.bench.peers.round_inbox import RoundInbox

CYCLONEDDS_SETTINGS = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name='lo' multicast='false'/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>100</MaxAutoParticipantIndex>
<Peers><Peer address='127.0.0.1'/></Peers></Discovery></Domain></CycloneDDS>"""


def state_type() -> type[Any]:
    """Return the IDL struct of a message: source, round, six numbers."""
    idl = importlib.import_module("cyclonedds.idl")
    kinds = importlib.import_module("cyclonedds.idl.types")
    fields = {
        "source": kinds.uint32,
        "k": kinds.uint32,
        "x": kinds.array[kinds.float64, 6],
    }
    made = types.new_class(
        "State",
        (idl.IdlStruct,),
        {"typename": "State"},
        lambda names: names.update(__annotations__=fields, __module__=__name__),
    )
    return dataclasses.dataclass(made)


class Participant:
    """The agents of one process in one domain."""

    def __init__(self, spec: dict[str, Any], loop: asyncio.AbstractEventLoop) -> None:
        self.spec = spec
        self.loop = loop
        self.type = state_type()
        self.queue: deque[tuple[RoundInbox, Any]] = deque()
        self.armed = False
        self.inboxes = {i: RoundInbox(len(spec["neighbors"][i])) for i in spec["mine"]}
        self._join()

    def _join(self) -> None:
        domain = importlib.import_module("cyclonedds.domain")
        sub = importlib.import_module("cyclonedds.sub")
        pub = importlib.import_module("cyclonedds.pub")
        core = importlib.import_module("cyclonedds.core")
        reliable = core.Policy.Reliability.Reliable(
            importlib.import_module("cyclonedds.util").duration(seconds=5)
        )
        qos = core.Qos(reliable, core.Policy.History.KeepLast(16))
        self.participant = domain.DomainParticipant(self.spec["domain"])
        self.writers = {
            i: pub.DataWriter(self.participant, self._topic(i), qos=qos)
            for i in self.spec["mine"]
        }
        self.readers = [
            sub.DataReader(
                self.participant,
                self._topic(j),
                qos=qos,
                listener=self._listener(core, inbox),
            )
            for i, inbox in self.inboxes.items()
            for j in self.spec["neighbors"][i]
        ]

    def _topic(self, i: int) -> Any:
        topics = importlib.import_module("cyclonedds.topic")
        return topics.Topic(self.participant, f"{self.spec['swarm']}_{i}", self.type)

    def _listener(self, core: Any, inbox: RoundInbox) -> Any:
        def on_data_available(listener: Any, reader: Any) -> None:
            self.queue.extend((inbox, message) for message in reader.take(N=32))
            if not self.armed:
                self.armed = True
                self.loop.call_soon_threadsafe(self._drain)

        return type(
            "Listener", (core.Listener,), {"on_data_available": on_data_available}
        )()

    def _drain(self) -> None:
        self.armed = False
        for _ in range(len(self.queue)):
            inbox, message = self.queue.popleft()
            inbox.put(message.source, message.k)

    def make_message(self, i: int, k: int) -> Any:
        """Return the message of an agent in round k."""
        return self.type(source=i, k=k, x=[0.0] * 6)

    def wait_until_matched(self) -> None:
        """Block until all our readers and writers have found their partners."""
        while not self.matched():
            time.sleep(0.05)

    def matched(self) -> bool:
        """Return whether all our readers and writers have found their partners."""
        needs = {i: len(js) for i, js in self.spec["neighbors"].items()}
        heard = all(
            len(writer.get_matched_subscriptions()) >= needs[i]
            for i, writer in self.writers.items()
        )
        return heard and all(
            len(reader.get_matched_publications()) > 0 for reader in self.readers
        )

    async def agent(self, i: int, rounds: dict[int, int]) -> None:
        """Exchange for ever."""
        writer = self.writers[i]
        inbox = self.inboxes[i]
        while True:
            writer.write(self.make_message(i, rounds[i]))
            await inbox.get(rounds[i])
            rounds[i] += 1


async def main() -> None:
    """Find the others, wait for go, and exchange until killed."""
    spec = specification()
    participant = Participant(spec, asyncio.get_running_loop())
    rounds = dict.fromkeys(spec["mine"], 0)
    participant.wait_until_matched()
    say({"ready": True})
    await asyncio.to_thread(wait_for_go)
    report(rounds, spec)
    await asyncio.gather(*(participant.agent(i, rounds) for i in spec["mine"]))


if __name__ == "__main__":
    os.environ["CYCLONEDDS_URI"] = CYCLONEDDS_SETTINGS
    importlib.import_module("uvloop").run(main())
