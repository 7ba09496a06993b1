"""The swarm file, checked, and the built-in swarms."""

import json
import math
from collections.abc import Iterable
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import msgspec

from crazychoir.config.checks import check_swarm, graph_of, is_secured
from crazychoir.config.file_paths import resolve_mission, resolve_paths
from crazychoir.config.radio_checks import body_name, has_radio
from crazychoir.config.reader import parse, read_table, require_plain
from crazychoir.config.shared_drone_values import fill_in_defaults, leave_out_drones
from crazychoir.config.shared_values import share
from crazychoir.config.tables import (
    ControlTable,
    DroneTable,
    LinkTable,
    Sender,
    Swarm,
)
from crazychoir.config.topology import Topology
from crazychoir.config.uris import canonical_uri
from crazychoir.errors import ConfigError
from crazychoir.files.text_files import read_text
from crazychoir.team.graph import Graph, describe_ids

HOME_SPACING = 0.6
"""m between the homes of a built-in swarm."""
FENCE_MARGIN = 4.0
"""m from the homes of a built-in swarm to its fence."""


class SwarmConfig(Swarm, frozen=True, kw_only=True, dict=True):
    """A checked swarm file: `load`, `loads`, `of` and `replace` check it and raise ConfigError.

    The fields are those of tables.Swarm. The key `graph` of the file is the field `graph_name`;
    `graph()` builds the graph.
    """

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a .toml or .json file.

        Paths in it are relative to its folder: the mission, the files of its options, and the files
        of [mujoco], [mocap] and [security].
        """
        do = 'A minimal file has name = "lab" and a table [[drones]] with id = 0 and home = [0, 0, 0] for each drone.'
        text = read_text(path, "a swarm file, TOML or JSON", do=do)
        config = cls.loads(text, str(path))
        return resolve_paths(config, Path(path).parent)

    @classmethod
    def loads(cls, text: str, where: str = "swarm") -> Self:
        """Read TOML or JSON text; `where` is its name in error texts."""
        return cls.of(parse(text, where), where)

    @classmethod
    def of(cls, raw: dict[str, Any], where: str = "swarm") -> Self:
        """Return the swarm of plain values, as a parser returns them."""
        require_plain(raw, where)
        flown = leave_out_drones(fill_in_defaults(raw))
        config = read_table(flown, cls, where)
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
        return resolve_mission(config, Path()) if "mission" in changes else config

    def with_network(self, **effects: float) -> Self:
        """Return this swarm with other effects of [network]; its other keys stay.

        effects: keys of tables.LinkTable, such as loss=0.3
        Raises ConfigError for a value that is not allowed.
        """
        where = f"swarm {self.name}"
        require_plain({"network": effects}, where)
        given = read_table(effects, LinkTable, where, "network", type(self))
        changes = {name: getattr(given, name) for name in effects}
        network = msgspec.structs.replace(self.network, **changes)
        network.require_possible_bursts(f"{where}: network.burst")
        return msgspec.structs.replace(self, network=network)

    @cached_property
    def ids(self) -> tuple[int, ...]:
        """Drone ids, increasing."""
        return tuple(sorted(drone.id for drone in self.drones))

    @cached_property
    def _drones_by_id(self) -> dict[int, DroneTable]:
        return {drone.id: drone for drone in self.drones}

    def drone(self, i: int) -> DroneTable:
        """Return the [[drones]] with id i; raise ConfigError if there is none."""
        drone = self._drones_by_id.get(i)
        if drone is None:
            raise ConfigError(
                f"swarm {self.name}", f"drone {i}", describe_ids(self.ids)
            )
        return drone

    def find_drones(self, words: Iterable[int | str], where: str) -> list[int]:
        """Return the ids of drones that a user names, each once.

        words: ids and names
        where: name of the option or argument, for errors
        Raises ConfigError for an id or a name that the swarm does not have.
        """
        id_by_name = {drone.name: drone.id for drone in self.drones if drone.name}
        found: dict[int, None] = {}
        for word in words:
            i = id_by_name.get(word) if isinstance(word, str) else word
            if i is None:
                names = ", ".join(id_by_name) or "no names"
                near = get_close_matches(str(word), id_by_name, n=1)
                advice = f"Did you mean {near[0]}?" if near else ""
                allowed = f"{names}, or the ids {describe_ids(self.ids)}"
                raise ConfigError(where, word, allowed, advice)
            if i not in self.ids:
                raise ConfigError(where, f"drone {i}", describe_ids(self.ids))
            found[i] = None
        return list(found)

    @cached_property
    def topology(self) -> Topology:
        """Which process has the body of each drone and sends its pose, in real time."""
        return Topology(self)

    @property
    def secured(self) -> bool:
        """True if the network is encrypted, and open only to holders of a certificate."""
        return is_secured(self)

    def body_name(self, i: int) -> str:
        """Return the name of drone i in motion capture."""
        return body_name(self.drone(i))

    def control_of(self, i: int) -> ControlTable:
        """Return the [[roles]] of drone i, else [control], with its sender filled in.

        The default for a drone with a radio is "frpy": if the link fails, it flies on level.
        """
        drone = self.drone(i)
        streamed: Sender = "frpy" if has_radio(drone) else "fpqr"
        return share(self, _fill_in_sender, drone.role, streamed)

    def graph(self) -> Graph:
        """Return the communication graph."""
        return share(self, _build_graph)


def _fill_in_sender(config: SwarmConfig, role: str, streamed: Sender) -> ControlTable:
    """Return the [[roles]] with this name, else [control], with its sender filled in.

    streamed: the default sender
    """
    row = next((row for row in config.roles if row.name == role), config.control)
    return msgspec.structs.replace(row, sender=row.sender or streamed)


def _build_graph(config: SwarmConfig) -> Graph:
    return graph_of(config, f"swarm {config.name}")


def default_swarm(n: int) -> SwarmConfig:
    """Return n simulated drones on a square grid on the floor, in a ring graph, without a mission."""
    return _on_a_grid("default", n, columns=max(1, math.ceil(math.sqrt(n))))


def demo_swarm() -> SwarmConfig:
    """Return six simulated drones that share pickups and deliveries."""
    return _on_a_grid("demo", 6, columns=3).replace(mission="pickup_delivery")


def find_swarm(option: str | None = None) -> tuple[SwarmConfig, str]:
    """Return the swarm to fly, and a text that says where it comes from.

    It is the given file, else ./swarm.toml, else the demo swarm.

    option: path of a swarm file, or None
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
