"""The swarm file, checked: its drones, their graph, the place
of each process, and the world of each drone.
"""

import hashlib
import ipaddress
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import msgspec

from crazychoir.bus.network import authority
from crazychoir.bus.network.access import NetworkAccess
from crazychoir.bus.network.endpoints import are_local
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS, Topic
from crazychoir.config.checks import (
    ROUTER_BELOW,
    WORLD_URIS,
    check_swarm,
    graph_of,
    is_secured,
    world_owned_drones,
)
from crazychoir.config.radio_checks import (
    body_name,
    camera_drones,
    drones_by_dongle,
    has_radio,
    radio_drones,
)
from crazychoir.config.reader import parse, read_table, require_plain
from crazychoir.config.tables import (
    AGREED_KEYS,
    BODY_KEYS,
    HOST_KEYS,
    ControlTable,
    DroneTable,
    Sender,
    Swarm,
    SwarmTable,
)
from crazychoir.config.uris import canonical_uri
from crazychoir.errors import ConfigError
from crazychoir.files.path_texts import as_path, json_bytes
from crazychoir.files.text_files import read_text
from crazychoir.team.graph import Graph, describe_ids

LOCAL_ADDRESS = "127.0.0.1"
"""Address of this machine."""


@dataclass(frozen=True, slots=True)
class ProcessNumbers:
    """Numbers of the processes without agents. The process of an agent has the number of its
    lowest drone.
    """

    world: int = -1
    """Process of the world's owner."""
    motion_capture: int = -2
    """Process of motion capture."""
    first_dongle: int = -3
    """Process of dongle 0; that of dongle K has first_dongle - K."""
    router: int = -ROUTER_BELOW
    """Process of the router."""


PROCESS_NUMBERS = ProcessNumbers()


HOME_SPACING = 0.6
"""m between the homes of a built-in swarm."""
FENCE_MARGIN = 4.0
"""m from the homes of a built-in swarm to its fence."""
FILE_OPTIONS = ("instance", "drawing")
"""Options of missions that name a file."""
SHAPE_FILE_KEYS = ("model", "scene")
"""Keys of [mujoco] that name a file; only the host of the world's owner needs these files."""


class SwarmConfig(Swarm, frozen=True, kw_only=True):
    """A checked swarm file: `load`, `loads`, `of` and `replace` check it and raise ConfigError.

    The fields are those of tables.Swarm. The key `graph` of the file is the field `topology`;
    `graph()` builds the graph.
    """

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a .toml or .json file.

        Paths in it are relative to its folder: the mission, the FILES of its options, and the files
        of [mujoco], [mocap] and [security].
        """
        do = 'A minimal file has name = "lab" and a table [[drones]] with id = 0 and home = [0, 0, 0] for each drone.'
        text = read_text(path, "a swarm file, TOML or JSON", do=do)
        config = cls.loads(text, str(path))
        folder = Path(path).parent
        return (
            config._with_mission_from(folder)
            ._with_files_from(folder)
            ._with_shapes_from(folder)
            ._with_keys(folder)
        )

    @classmethod
    def loads(cls, text: str, where: str = "swarm") -> Self:
        """Read TOML or JSON text; `where` is its name in error texts."""
        return cls.of(parse(text, where), where)

    @classmethod
    def of(cls, raw: dict[str, Any], where: str = "swarm") -> Self:
        """Return the swarm of plain values, as a parser returns them."""
        require_plain(raw, where)
        config = read_table(raw, cls, where)
        check_swarm(config, where)
        drones = tuple(
            msgspec.structs.replace(drone, uri=canonical_uri(drone.uri))
            for drone in config.drones
        )
        return msgspec.structs.replace(config, drones=drones)

    def dumps(self) -> str:
        """Return JSON text for `loads`, with all defaults, to hand the swarm to another process."""
        try:
            return msgspec.json.format(msgspec.json.encode(self), indent=2).decode()
        except UnicodeEncodeError:
            # A path has bytes that are not UTF-8: the standard library escapes them.
            return json.dumps(msgspec.to_builtins(self), indent=2)

    def replace(self, **changes: Any) -> Self:
        """Return this swarm with other values of some keys, named as in the file.

        A mission's path is relative to the current folder.
        """
        raw = {**msgspec.to_builtins(self), **msgspec.to_builtins(changes)}
        config = self.of(raw, f"swarm {self.name}")
        return config._with_mission_from(Path()) if "mission" in changes else config

    def _with_mission_from(self, folder: Path) -> Self:
        """Return the swarm with the full path of its mission."""
        if self.mission is None or not self.mission.endswith(".py"):
            return self
        return msgspec.structs.replace(
            self, mission=_full_path(folder, self.mission, "mission")
        )

    def _with_files_from(self, folder: Path) -> Self:
        """Return the swarm with the full paths of its files."""
        named = {
            key: value
            for key, value in self.mission_options.items()
            if key in FILE_OPTIONS and isinstance(value, str)
        }
        found = {
            key: _full_path(folder, value, f"mission_options.{key}")
            for key, value in named.items()
        }
        drones = tuple(_resolve_replay(drone, folder) for drone in self.drones)
        mocap = self.mocap
        if mocap.file:
            mocap = msgspec.structs.replace(
                mocap, file=_full_path(folder, mocap.file, "mocap.file")
            )
        return msgspec.structs.replace(
            self,
            mission_options=self.mission_options | found,
            drones=drones,
            mocap=mocap,
        )

    def _with_shapes_from(self, folder: Path) -> Self:
        """Return the swarm with the full paths of the files of [mujoco]."""
        named = {
            key: value
            for key in SHAPE_FILE_KEYS
            if (value := getattr(self.mujoco, key))
        }
        found = {
            key: _full_path(folder, value, f"mujoco.{key}")
            for key, value in named.items()
        }
        mujoco = msgspec.structs.replace(self.mujoco, **found)
        return msgspec.structs.replace(self, mujoco=mujoco) if found else self

    def _with_keys(self, folder: Path) -> Self:
        """Return the swarm with the full path of its folder of keys."""
        if not self.secured:
            return self
        keys = _full_path(folder, self.security.keys, "security.keys")
        return msgspec.structs.replace(
            self, security=msgspec.structs.replace(self.security, keys=keys)
        )

    @property
    def files(self) -> dict[str, Path]:
        """The files that a flight needs in addition to its mission, by the keys that name them."""
        options = self.mission_options
        mujoco = self.mujoco
        named = {
            f"mission_options.{key}": options[key]
            for key in FILE_OPTIONS
            if isinstance(options.get(key), str)
        }
        named |= {
            f"mujoco.{key}": name
            for key in SHAPE_FILE_KEYS
            if (name := getattr(mujoco, key))
        }
        for drone in self.drones:
            if drone.uri.startswith(WORLD_URIS.replay):
                named[f"drone {drone.id}: uri"] = drone.uri.removeprefix(
                    WORLD_URIS.replay
                ).partition("?")[0]
        return {key: Path(name) for key, name in named.items()}

    def digest(self) -> str:
        """Return 16 hex digits that are equal at all hosts of one
        mission, for every Python and hash seed.

        All keys count but `hosts`, `router`, `security`, `base_port` and `network`. Of the mission,
        of shapes and of recordings of poses only the file name counts, not the folder. A file in
        the mission's options counts by its content.
        """
        return hashlib.blake2b(
            json_bytes(self._agreed(), order="sorted"), digest_size=8
        ).hexdigest()

    def digests(self) -> str:
        """Return two hex digits for each of the keys AGREED, to
        name the keys in which two files differ.
        """
        agreed = self._agreed()
        said = [json_bytes(agreed[key], order="sorted") for key in AGREED_KEYS]
        return "".join(
            hashlib.blake2b(value, digest_size=1).hexdigest() for value in said
        )

    def of_bodies(self) -> dict[str, str]:
        """Return hex digits for each of the keys OF_BODIES, equal for equal values.

        No file is read.
        """
        agreed: dict[str, Any] = msgspec.to_builtins(self)
        agreed["mujoco"] |= {
            key: Path(getattr(self.mujoco, key)).name for key in SHAPE_FILE_KEYS
        }
        for drone in agreed["drones"]:
            drone["uri"] = (
                drone["uri"].rpartition("/")[2]
                if drone["uri"].startswith(WORLD_URIS.replay)
                else drone["uri"]
            )
        said = {key: json_bytes(agreed[key], order="sorted") for key in BODY_KEYS}
        return {
            key: hashlib.blake2b(value, digest_size=4).hexdigest()
            for key, value in said.items()
        }

    def _agreed(self) -> dict[str, Any]:
        """Return the plain values that must be equal at all hosts, with
        the content of files instead of their paths.
        """
        agreed = {
            key: value
            for key, value in msgspec.to_builtins(self).items()
            if key not in HOST_KEYS
        }
        agreed["mission"] = Path(self.mission or "").name
        agreed["mujoco"] |= {
            key: Path(getattr(self.mujoco, key)).name for key in SHAPE_FILE_KEYS
        }
        agreed["mocap"]["file"] = Path(self.mocap.file).name
        agreed["mission_options"] = {
            key: _content(value) for key, value in self.mission_options.items()
        }
        for drone in agreed["drones"]:
            name, mark, number = (
                drone["uri"].removeprefix(WORLD_URIS.replay).partition("?")
            )
            drone["uri"] = (
                drone["uri"]
                if name == drone["uri"]
                else f"{WORLD_URIS.replay}{_content(name)}{mark}{number}"
            )
        return agreed

    @property
    def ids(self) -> tuple[int, ...]:
        """Drone ids, increasing."""
        return tuple(sorted(drone.id for drone in self.drones))

    def drone(self, i: int) -> DroneTable:
        """Return the [[drones]] with id i; raise ConfigError if there is none."""
        for drone in self.drones:
            if drone.id == i:
                return drone
        raise ConfigError(f"swarm {self.name}", f"drone {i}", describe_ids(self.ids))

    def control_of(self, i: int) -> ControlTable:
        """Return the [[roles]] of drone i, else [control], with its sender filled in.

        The default for a drone with a radio is "frpy": if the link fails, it flies on level.
        """
        drone = self.drone(i)
        row = next((row for row in self.roles if row.name == drone.role), self.control)
        streamed: Sender = "frpy" if has_radio(drone) else "fpqr"
        return msgspec.structs.replace(row, sender=row.sender or streamed)

    def graph(self) -> Graph:
        """Return the communication graph."""
        return graph_of(self, f"swarm {self.name}")

    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Return the drones of each process, increasing.

        A process has the number of its lowest drone.
        """
        return tuple(
            sorted(
                tuple(sorted(group))
                for group in self.processes or ((i,) for i in self.ids)
            )
        )

    def process(self, i: int) -> int:
        """Return the process of drone i: its lowest drone."""
        member = self.drone(i).id
        return next(group[0] for group in self.groups() if member in group)

    def endpoint(self, i: int) -> str:
        """Return the endpoint of the process of drone i:
        tcp/<address of its host>:<base port + the process>.
        """
        return self._listens(self.drone(i).host, self.process(i))

    def endpoints(self) -> dict[int, str]:
        """Return the endpoint of each process, by its number.

        The router and the owners come first.
        """
        listens = {
            process: self._listens(host, process)
            for process, host in self._owners().items()
        }
        return listens | {group[0]: self.endpoint(group[0]) for group in self.groups()}

    def host_of(self, process: int) -> str | None:
        """Return the host of a process of `endpoints`; None without [hosts]."""
        return self.drone(process).host if process >= 0 else self._owners()[process]

    @property
    def routers(self) -> list[str]:
        """The endpoint of the router, if there is one: then every process connects only to it."""
        return (
            [self._listens(self.router, PROCESS_NUMBERS.router)]
            if self.router is not None
            else []
        )

    def _owners(self) -> dict[int, str | None]:
        """Return the hosts of the processes that are not agents."""
        owners: dict[int, str | None] = (
            {PROCESS_NUMBERS.router: self.router} if self.router is not None else {}
        )
        owners |= {
            PROCESS_NUMBERS.first_dongle - k: self.dongle_host(k)
            for k in reversed(self.dongles)
        }
        owners |= {PROCESS_NUMBERS.motion_capture: self.mocap.host} if self.seen else {}
        return owners | ({PROCESS_NUMBERS.world: self.world.host} if self.owned else {})

    def _listens(self, host: str | None, process: int) -> str:
        address = LOCAL_ADDRESS if host is None else self.hosts[host]
        return f"{self.scheme}/{_bracket_address(address)}:{self.base_port + process}"

    @property
    def scheme(self) -> str:
        """Scheme of the endpoints."""
        return "tls" if self.secured else "tcp"

    @property
    def secured(self) -> bool:
        """True if the network is encrypted, and open only to holders of a certificate."""
        return is_secured(self)

    def access(self, host: str, *endpoints: str) -> NetworkAccess | None:
        """Return the access rules as a host applies them; None if the network is open to all.

        endpoints: given instead of those of the file
        Raises ConfigError for missing or bad keys, and for an endpoint beyond this machine if the
        file has neither keys nor insecure = true.
        """
        if not self.secured:
            self._require_local(endpoints)
            return None
        owners = [(self.dongle_host(k), f"dongle{k}") for k in self.dongles]
        owners += [(self.mocap.host, "mocap")] if self.seen else []
        owners += [(self.world.host, "world")] if self.owned else []
        agents = [(drone.host, str(drone.id)) for drone in self.drones]
        processes: dict[str, tuple[str, ...]] = {
            name: () for name in (*self.hosts, *self.security.operators)
        }
        for of, name in (*owners, *agents):
            processes[str(of)] += (name,)
        holders = {drone.id: str(drone.host) for drone in self.drones}
        holders |= {
            PORT_ADDRESSES.body_offset + i: str(self.world.host) for i in self.owned
        }
        holders |= {
            PORT_ADDRESSES.body_offset + i: str(self.dongle_host(k))
            for k, ids in self.dongles.items()
            for i in ids
        }
        holders |= {
            PORT_ADDRESSES.camera_offset + i: str(self.mocap.host) for i in self.seen
        }
        folder = authority.check_keys(Path(self.security.keys), host)
        return NetworkAccess(
            self.name,
            host,
            folder,
            processes,
            holders,
            self.security.operators,
            self.router,
        )

    def _require_local(self, endpoints: Iterable[str]) -> None:
        """Raise ConfigError for an endpoint beyond this machine,
        unless the file allows an insecure network.
        """
        far = [
            endpoint
            for endpoint in endpoints
            if "/" in endpoint and not are_local([endpoint])
        ]  # a text without "/" is no endpoint
        if far and not self.security.insecure:
            allowed = "one of this machine's own, as tcp/127.0.0.1:7460"
            do = "Give the swarm file [hosts] and keys (deploy/README.md), or write insecure = true in [security]."
            raise ConfigError(
                "endpoint", far[0], allowed, do, "neither encrypted nor closed"
            )

    @property
    def owned(self) -> tuple[int, ...]:
        """The drones simulated, in real time, by the process of the world's owner; increasing."""
        return world_owned_drones(self)

    @property
    def reached(self) -> tuple[int, ...]:
        """The drones with a radio, udp:// or radio://; increasing."""
        return radio_drones(self)

    @property
    def seen(self) -> tuple[int, ...]:
        """The drones with poses from the process of motion capture; increasing."""
        return camera_drones(self)

    @property
    def unseen(self) -> tuple[int, ...]:
        """The drones with a radio that estimate their own pose, which is also their truth.

        The ids are in increasing order.
        """
        return tuple(i for i in self.reached if i not in self.seen)

    @property
    def elsewhere(self) -> tuple[int, ...]:
        """The drones with a body, in real time, outside the process of their agent; increasing."""
        return tuple(sorted((*self.owned, *self.reached)))

    @property
    def dongles(self) -> dict[int, tuple[int, ...]]:
        """The drones of each dongle, by its number; both increasing."""
        return drones_by_dongle(self)

    def dongle_host(self, number: int) -> str | None:
        """Return the host of a dongle's owner."""
        return next(
            (row.host for row in self.radio.dongles if row.dongle == number), None
        )

    def body_name(self, i: int) -> str:
        """Return the name of drone i in motion capture."""
        return body_name(self.drone(i))

    def source(self, topic: Topic, i: int) -> int:
        """Return the address that sends a topic of drone i in real
        time: its agent, its body or the cameras.
        """
        if not topic.of_body or i not in self.elsewhere:
            return i
        return (
            PORT_ADDRESSES.camera_offset + i
            if topic in (DRONE_TOPICS.pose, DRONE_TOPICS.truth) and i in self.seen
            else PORT_ADDRESSES.body_offset + i
        )

    def impairment(self) -> dict[str, Any]:
        """Return [network] as plain values, with only the keys that are written in the file.

        The groups of a partition name every drone.
        """
        network = self.network
        rules = _written_values(network)
        if network.edges:
            rules["edges"] = [_written_values(edge) for edge in network.edges]
        if network.partitions:
            rules["partitions"] = [
                _written_values(cut) | {"groups": self._complete(cut.groups)}
                for cut in network.partitions
            ]
        return rules

    def _complete(self, groups: tuple[tuple[int, ...], ...]) -> list[list[int]]:
        """Return the groups, and one more with the drones that they do not name."""
        rest = [i for i in self.ids if not any(i in group for group in groups)]
        return [list(group) for group in groups] + ([rest] if rest else [])


def _resolve_replay(drone: DroneTable, folder: Path) -> DroneTable:
    """Return the drone with the full path of the recording that it replays, if it replays one."""
    name = drone.uri.removeprefix(WORLD_URIS.replay)
    if name == drone.uri:
        return drone
    return msgspec.structs.replace(
        drone,
        uri=f"{WORLD_URIS.replay}{_full_path(folder, name, f'drone {drone.id}: uri')}",
    )


def _full_path(folder: Path, name: str, key: str) -> str:
    """Return the full path of a file.

    key: the key that names the file, for the error
    Raises ConfigError for a name that no file here can have.
    """
    try:
        return str((folder / as_path(name)).resolve())
    except (ValueError, OSError, RuntimeError) as error:
        do = "Rename the file; or, for letters that this system does not know, set PYTHONUTF8=1 or LC_ALL=C.UTF-8."
        raise ConfigError(
            key, ascii(name), f"the name of a file ({error})", do
        ) from error


def _content(value: Any) -> Any:
    """Return the hash of a file's content if the value is its path, else the value."""
    if not isinstance(value, str) or len(value) > 1000 or not Path(value).is_file():
        return value
    return hashlib.blake2b(Path(value).read_bytes(), digest_size=8).hexdigest()


def default_swarm(n: int) -> SwarmConfig:
    """Return n simulated drones on a square grid on the
    floor, in a ring graph, without a mission.
    """
    return _on_a_grid("default", n, columns=max(1, math.ceil(math.sqrt(n))))


def demo_swarm() -> SwarmConfig:
    """Return six simulated drones that share pickups and deliveries."""
    return _on_a_grid("demo", 6, columns=3).replace(mission="pickup_delivery")


def find_swarm(option: str | None = None) -> tuple[SwarmConfig, str]:
    """Return the swarm to fly, and a text with its origin.

    It is the given file, else ./swarm.toml, else the demo swarm.
    """
    if option is not None:
        return SwarmConfig.load(option), option
    if Path("swarm.toml").is_file():
        return SwarmConfig.load("swarm.toml"), "swarm.toml of this folder"
    return demo_swarm(), "the built-in demo swarm: six drones, pickup_delivery"


def _on_a_grid(name: str, n: int, columns: int) -> SwarmConfig:
    """Return a swarm of n simulated drones on a grid."""
    homes = [
        [
            round(HOME_SPACING * (k % columns), 3),
            round(HOME_SPACING * (k // columns), 3),
            0.0,
        ]
        for k in range(n)
    ]
    far = [
        max((home[axis] for home in homes), default=0.0) + FENCE_MARGIN
        for axis in (0, 1)
    ]
    drones = [{"id": k, "home": home} for k, home in enumerate(homes)]
    fence = {"min": [-FENCE_MARGIN, -FENCE_MARGIN, 0.0], "max": [*far, 3.0]}
    return SwarmConfig.of(
        {"name": name, "drones": drones, "graph": "ring", "fence": fence},
        f"swarm {name}",
    )


def _bracket_address(address: str) -> str:
    try:
        return f"[{address}]" if ipaddress.ip_address(address).version == 6 else address
    except ValueError:
        return address


def _written_values(table: SwarmTable) -> dict[str, Any]:
    """Return the values of a table that are written in the file, without its lists."""
    values: dict[str, Any] = msgspec.to_builtins(table)
    return {
        key: value
        for key, value in values.items()
        if not (value is None or isinstance(value, tuple))
    }
