"""Which processes may take part: real sessions with a certificate, with none, with a foreign or another host's one."""

import asyncio
import contextlib
import dataclasses
import datetime
import json
import signal

import pytest
import zenoh
from message_parts import taking_parts
from ports import free_ports
from system.agents import CRAZYCHOIR, Program
from system.link_process import linked, wall_clock

from crazychoir.bus.codec import encode
from crazychoir.bus.frames import Envelope, Frame, encode_frame
from crazychoir.bus.message import Message
from crazychoir.bus.network import authority, flood_limit, zenoh_session
from crazychoir.bus.network.authority import KEY_FILES
from crazychoir.bus.network.greeter import HELLO_TIMING
from crazychoir.bus.topics import DRONE_TOPICS, MESSAGE_TOPICS
from crazychoir.cli.setup import host_facts
from crazychoir.config.access import access_of
from crazychoir.config.addresses import Addresses
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.types import Status

pytestmark = [pytest.mark.system, pytest.mark.real_time]
OBSERVER = 10_001
HEARD = 1.0  # s within which a frame would have come
SECURED = {"insecure": False, "operators": ["console"]}


class Lab:
    """Two hosts of this machine with mutual TLS: drone 0 is on a, drone 1 on b, the operator on console."""

    def __init__(self, folder, clock, stack):
        self.folder, self.clock, self.stack, self.keys = (
            folder,
            clock,
            stack,
            folder / "keys",
        )
        authority.make_authority(self.keys)
        for name in ("a", "b", "console"):
            authority.add_host(self.keys, name)
        self.config = SwarmConfig.of(
            {
                "name": "closed",
                "hosts": {"a": "127.0.0.1", "b": "127.0.0.1"},
                "base_port": free_ports([0, 1]),
                "security": SECURED | {"keys": str(self.keys)},
                "drones": [
                    {"id": i, "home": [1.0 * i, 0, 0], "host": "ab"[i]}
                    for i in range(2)
                ],
            }
        )

    async def link(self, host, process, drones, connect=True, **options):
        """A process of a host, as the swarm file has it."""
        first, second = Addresses(self.config).endpoints().values()
        own = {"a": first, "b": second}.get(host, "tls/127.0.0.1:0")
        made = linked(
            self.clock,
            process,
            "closed",
            drones,
            host=host,
            listen=[own],
            connect=[first] if connect else [],
            access=access_of(self.config, host),
            **options,
        )
        return await self.stack.enter_async_context(made)

    def intruder(self, folder=None):
        """A session of another program, with the keys of a folder, or with none."""
        config = zenoh.Config()
        tls = {
            "root_ca_certificate": str(
                (folder or self.keys / "a") / KEY_FILES.authority_certificate
            ),
            "verify_name_on_connect": False,
        }
        if folder is not None:
            tls |= {
                "connect_private_key": str(folder / KEY_FILES.private_key),
                "connect_certificate": str(folder / KEY_FILES.certificate),
            }
            tls["enable_mtls"] = True
        settings = {
            "mode": "peer",
            "connect/endpoints": [Addresses(self.config).endpoint(0)],
            "scouting/multicast/enabled": False,
            "transport/shared_memory/enabled": False,
            "transport/link/tls": tls,
        }
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        session = zenoh.open(config)
        self.stack.callback(session.close)
        return session


@pytest.fixture
async def lab(tmp_path):
    async with wall_clock() as clock, contextlib.AsyncExitStack() as stack:
        yield Lab(tmp_path, clock, stack)


async def until(condition, seconds=10.0):
    async with asyncio.timeout(seconds):
        while not condition():  # noqa: ASYNC110 - of Zenoh's threads
            await asyncio.sleep(0.01)


async def speaks(lab, of, link, host="b", process="1-f", seconds=HEARD, asks=("**",)):
    """Let an intruder speak as `process` while drone 0 speaks; return the keys it hears, and how many frames came."""
    heard, before = (
        [],
        link.counters.frames_received
        + link.counters.strangers
        + link.counters.malformed,
    )
    subscribers = [
        of.declare_subscriber(one, lambda sample: heard.append(str(sample.key_expr)))
        for one in asks
    ]
    token = of.liveliness().declare_token(f"choir/closed/live/{host}/{process}")
    frame = encode_frame(
        Frame(
            process,
            1,
            DRONE_TOPICS.status.klass,
            [Envelope(DRONE_TOPICS.status.number, 1, (0,), 1, 0, 0.0, "", b"x")],
        )
    )
    for _ in range(round(seconds / 0.05)):
        of.put(f"choir/closed/f/{link.bus.process}/{host}/{process}/control", frame)
        link.bus.ports[0].publish(DRONE_TOPICS.status, Status("on ground"))
        await asyncio.sleep(0.05)
    token.undeclare()
    for subscriber in subscribers:
        subscriber.undeclare()
    came = (
        link.counters.frames_received
        + link.counters.strangers
        + link.counters.malformed
        - before
    )
    return [key for key in heard if f"/{process}/" not in f"{key}/"], came


def foreign(lab, folder="other"):
    other = lab.folder / folder
    authority.make_authority(other)
    return authority.add_host(other, "a")


def pretender(lab):
    """A foreign certificate beside the lab's own root."""
    folder = foreign(lab, "pretended")
    (folder / KEY_FILES.authority_certificate).write_bytes(
        (lab.keys / "a" / KEY_FILES.authority_certificate).read_bytes()
    )
    return folder


def expired(lab):
    """Return keys with a certificate that the authority has signed, and that ended a minute ago."""
    now = authority.date_and_time
    authority.date_and_time = lambda: now() - datetime.timedelta(days=1, minutes=1)
    try:
        return authority.add_host(lab.keys, "late", days=1)
    finally:
        authority.date_and_time = now


async def test_without_a_good_certificate_nothing_is_read_and_nothing_heard(lab):
    """No certificate, a foreign one, a foreign one beside the lab's own root, an expired one, a revoked one."""
    good = lab.folder / "kept"
    (lab.keys / "b").rename(good)
    authority.add_host(lab.keys, "b")
    authority.revoke_host(lab.keys, "b")
    link = await lab.link("a", "0-1", [0])
    intruders = {
        name: lab.intruder(keys)
        for name, keys in (
            ("none", None),
            ("foreign", foreign(lab)),
            ("pretender", pretender(lab)),
            ("expired", expired(lab)),
            ("revoked", good),
        )
    }
    found = await asyncio.gather(
        *(
            speaks(lab, intruder, link, process=f"1-{name}")
            for name, intruder in intruders.items()
        )
    )
    assert dict(zip(intruders, found, strict=True)) == dict.fromkeys(intruders, ([], 0))
    assert link.peers == {}


async def test_with_the_certificate_of_a_host_its_own_name_is_heard(lab):
    """A good certificate lets messages through: if none came through, the other tests could not fail."""
    link = await lab.link("a", "0-1", [0])
    heard, came = await speaks(lab, lab.intruder(lab.keys / "b"), link)
    assert came > 10
    assert "1-f" in link.peers or link.counters.strangers > 10
    assert heard == []


async def test_a_host_is_held_to_its_own_name_and_reads_nothing_of_others(lab):
    """The certificate of b, in a program of its own that asks for everything and says it is a."""
    asks = (
        "**",
        "choir/closed/f/**",
        "choir/closed/f/observer-$*/**",
        "choir/closed/f/*/a/**",
    )
    link = await lab.link("a", "0-1", [0])
    friend = await lab.link("console", "observer-console.1", [OBSERVER])
    await until(
        lambda: (
            "observer-console.1" in link.peers
            and link.table.mutual(link.peers["observer-console.1"])
        )
    )
    intruder = lab.intruder(lab.keys / "b")
    heard, _ = await speaks(lab, intruder, link, host="a", process="0-2", asks=asks)
    assert [key for key in heard if "/observer-console.1/" in key] == [], (
        "what a says to the console is theirs"
    )
    assert "0-2" not in link.peers
    assert "0-2" not in friend.peers
    assert link.counters.malformed == 0


@pytest.mark.skipif(
    not zenoh_session.LISTS_LINKS, reason="Zenoh lists its links since 1.9"
)
async def test_a_program_with_the_certificate_of_a_host_that_is_no_process_of_it_is_told_once(
    lab, caplog
):
    link = await lab.link("a", "0-1", [0])
    lab.intruder(lab.keys / "b")
    await until(
        lambda: (
            "a program with the certificate of host b is connected and is no process"
            in caplog.text
        )
    )
    await asyncio.sleep(2.0 * HELLO_TIMING.check_period)
    assert caplog.text.count("a program with the certificate of host") == 1
    assert link.peers == {}


async def test_a_host_speaks_for_its_drones_alone(lab, caplog):
    link = await lab.link("a", "0-1", [0])
    liar = await lab.link("b", "1-1", [0])
    await until(lambda: link.peers.get("1-1") and link.peers["1-1"].refusal)
    assert 0 not in link.directory
    assert (
        "process 1-1 on host b speaks for drone 0, which the swarm file does not give to that host"
        in caplog.text
    )
    assert caplog.text.count("speaks for drone 0") == 1
    await liar.on_stop()


async def test_only_operators_are_obeyed_and_the_others_are_named_once(lab, caplog):
    link = await lab.link("a", "0-1", [0])
    commanded = []
    link.bus.ports[0].handlers[MESSAGE_TOPICS.request.number] = taking_parts(
        lambda *message: commanded.append(message)
    )
    others = {"b": await lab.link("b", "observer-b.2", [OBSERVER + 1])}
    others["console"] = await lab.link("console", "observer-console.1", [OBSERVER])
    await until(
        lambda: (
            len([peer for peer in link.peers.values() if link.table.mutual(peer)]) == 2
        )
    )
    await until(lambda: all(0 in other.directory for other in others.values()))
    for other in others.values():
        (port,) = other.bus.ports.values()
        for number in range(3):
            port.send(
                Message(
                    MESSAGE_TOPICS.request,
                    port.address,
                    encode(["land", {}, 5.0]),
                    number,
                    "1",
                    0,
                ),
                (0,),
                0,
            )
    await until(lambda: len(commanded) == 3 and link.counters.forbidden == 3)
    assert (
        caplog.text.count(
            "host b (process observer-b.2) commands and is no operator: not obeyed"
        )
        == 1
    )


async def test_the_doctor_names_the_certificate_that_is_not_accepted(lab):
    await lab.link("a", "0-1", [0])
    port = int(Addresses(lab.config).endpoint(0).rpartition(":")[2])

    async def found(keys):
        return await asyncio.to_thread(
            host_facts.try_handshake, "127.0.0.1", port, keys
        )

    assert await found(lab.keys / "b") == ""
    assert await found(lab.keys / "nobody") == "No such file or directory"
    assert "it does not accept the certificate of this host: " in await found(
        pretender(lab)
    )
    elsewhere = lab.folder / "elsewhere"
    authority.make_authority(elsewhere)
    assert "its certificate is not valid here: " in await found(
        authority.add_host(elsewhere, "b")
    )


async def test_each_program_of_the_swarm_reports_a_refused_process_once(lab):
    """The router of host a reports it, and so does a program that calls the router with keys of another swarm."""
    file = lab.folder / "swarm.json"
    file.write_text(lab.config.replace(router="a").dumps())
    at = Addresses(lab.config).endpoint(0)
    router = await Program.start(*CRAZYCHOIR, "router", "--swarm", file, "--listen", at)
    try:
        await router.says("router at")
        for keys in (None, pretender(lab), expired(lab)):
            for _ in range(2):
                lab.intruder(keys)
                await asyncio.sleep(0.3)
        refused = "a process connected and was refused: "
        await asyncio.sleep(1.5)  # they call again each second
        assert router.text.count(refused) == 3, router.text
        assert (
            f"{refused}peer sent no certificates. Nothing of it was read" in router.text
        )
        elsewhere = lab.folder / "elsewhere"
        authority.make_authority(elsewhere)
        authority.add_host(elsewhere, "console")
        other = lab.config.replace(security=SECURED | {"keys": str(elsewhere)})
        (lab.folder / "other.json").write_text(other.dumps())
        status = await Program.start(
            *CRAZYCHOIR, "status", "--swarm", lab.folder / "other.json", "--json"
        )
        ended = await status.end(30.0)
        assert (
            f"{at} and we do not accept each other's certificate: invalid peer certificate"
            in status.text
        )
        assert json.loads(ended["answer"]), "and nothing else on standard output"
        router.signal(signal.SIGINT)
        assert (await router.end(10.0))["answer"] == ""
    finally:
        await router.kill()


async def test_a_flood_is_cut_off_and_named_once_and_others_are_heard(
    lab, caplog, monkeypatch
):
    # A loaded machine sends more slowly than the limit of 20 000 frames/s.
    monkeypatch.setattr(
        flood_limit,
        "FLOOD_LIMITS",
        dataclasses.replace(flood_limit.FLOOD_LIMITS, frame_rate=1_000.0),
    )
    link = await lab.link("a", "0-1", [0])
    friend = await lab.link("console", "observer-console.1", [OBSERVER])
    await until(
        lambda: (
            "observer-console.1" in link.peers
            and link.table.mutual(link.peers["observer-console.1"])
        )
    )
    intruder = lab.intruder(lab.keys / "b")
    heard = []
    link.bus.ports[0].handlers[MESSAGE_TOPICS.request.number] = taking_parts(
        lambda *message: heard.append(message)
    )
    frame = encode_frame(Frame("1-f", 1, DRONE_TOPICS.status.klass, []))

    def flood():
        block = zenoh.CongestionControl.BLOCK
        for _ in range(60_000):
            intruder.put(
                "choir/closed/f/0-1/b/1-f/control", frame, congestion_control=block
            )

    flooding = asyncio.create_task(asyncio.to_thread(flood))
    asked = 0
    while not flooding.done():
        friend.bus.ports[OBSERVER].send(
            Message(
                MESSAGE_TOPICS.request,
                friend.bus.ports[OBSERVER].address,
                encode(["land", {}, 5.0]),
                asked,
                "1",
                0,
            ),
            (0,),
            0,
        )
        asked += 1
        await asyncio.sleep(0.01)
    await flooding
    await until(lambda: len(heard) == asked)
    await until(lambda: link.counters.flooded > 1_000)
    assert asked > 5
    assert link.counters.overflowed == 0
    assert caplog.text.count("host b floods us") == 1


async def test_a_host_cannot_put_another_s_name_behind_its_own_in_a_key(lab):
    """Access control looks at the beginning of a key; the receiver reads the sender at the same place."""
    link = await lab.link("a", "0-1", [0])
    friend = await lab.link("console", "observer-console.1", [OBSERVER])
    await until(
        lambda: (
            "observer-console.1" in link.peers
            and link.table.mutual(link.peers["observer-console.1"])
        )
    )
    commanded = []
    link.bus.ports[0].handlers[MESSAGE_TOPICS.request.number] = taking_parts(
        lambda *message: commanded.append(message)
    )
    order = Envelope(
        MESSAGE_TOPICS.request.number,
        OBSERVER,
        (0,),
        99,
        0,
        0.0,
        "1",
        encode(["land", {}, 5.0]),
    )
    frame = encode_frame(
        Frame("observer-console.1", 7, MESSAGE_TOPICS.request.klass, [order])
    )
    intruder = lab.intruder(lab.keys / "b")
    for _ in range(round(HEARD / 0.05)):
        for middle in ("b", "b/1-f", "b/1-f/x", "*", "**/b", "b/**"):
            intruder.put(
                f"choir/closed/f/0-1/{middle}/console/observer-console.1/rounds", frame
            )
        await asyncio.sleep(0.05)
    assert commanded == []
    assert friend.peers["0-1"].hello is not None


@pytest.mark.parametrize(
    ("listen", "times"), [("tcp/0.0.0.0:0", 1), ("tcp/127.0.0.1:0", 0)]
)
async def test_an_open_network_beyond_this_machine_is_said_at_start(
    listen, times, caplog
):
    async with (
        wall_clock() as clock,
        linked(clock, "0-1", "open", [0], listen=[listen]),
    ):
        assert (
            caplog.text.count("neither encrypted nor closed (security.insecure)")
            == times
        )
