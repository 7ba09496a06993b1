"""A swarm of Crazyswarm2 as a swarm file: drones, types, firmware parameters, logging, cameras."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from crazychoir.cli.setup.crazyswarm_files import (
    ImportRemarks,
    find_number,
    find_table,
    read_ros_parameters,
    read_yaml,
)
from crazychoir.config.radio_checks import LEAST_OWN_POSE_RATE
from crazychoir.config.reader import show_value, write_value
from crazychoir.config.tables import MocapTable
from crazychoir.errors import ConfigError

ROBOT_KEYS = {
    "enabled",
    "uri",
    "initial_position",
    "type",
    "firmware_params",
    "firmware_logging",
}
"""Keys of a robot that are taken over."""
TYPE_KEYS = {
    "motion_capture",
    "big_quad",
    "battery",
    "firmware_params",
    "firmware_logging",
    "connection",
}
"""Keys of a type of robot that are looked at."""
ALL_KEYS = {"firmware_params", "firmware_logging", "broadcasts"}
"""Keys for all robots that are looked at."""
CAMERA_KEYS = {"enabled", "tracking", "marker", "dynamics"}
"""Keys of a type's motion capture that are looked at."""
BATTERY_KEYS = {"voltage_warning", "voltage_critical"}
"""Keys of a type's battery that are looked at."""
LOGGING_KEYS = {"enabled", "default_topics", "custom_topics"}
"""Keys of the logging of a robot, a type or all robots that are taken over."""
KNOWN_CONNECTIONS = ("crazyflie", "none")
"""Connections of a robot: a Crazyflie by its uri, or an object that cameras see only."""
SET_HERE = {
    "commander.enHighLevel": "the planner on board needs no switch here",
    "kalman.resetEstimation": "done at each connection",
    "stabilizer.estimator": "set at each connection, to the Kalman filter",
    "stabilizer.controller": "set a sender in [control] instead",
}
"""Firmware parameters that a connection sets, or that mean something else here, and why."""
DEFAULT_TOPICS = {
    "pose": "topic state, always there",
    "odom": "topic state, always there",
    "status": "topics link and status, always there",
}
"""Default topics of Crazyswarm2 that are always there."""
SCAN_VARIABLES = ("range.front", "range.back", "range.left", "range.right")
"""Log variables of the topic scan."""
CAMERA_TYPES = ("vicon", "optitrack", "qualisys", "vrpn", "mock")
"""Types of motion capture that are known here by the same name."""
SHARED_DRONES = 3
"""Most drones of a dongle that get streamed set-points; more get "xyz"."""
FIRST_PORT = 19850
"""UDP port of the first virtual drone."""
FENCE_MARGIN = 1.5
"""m around the initial positions."""
LEAST_FENCE = (2.0, 2.0, 2.5)
"""m: the fence is at least as large, on each side and above."""
LOG_STEP = 0.01
"""s: periods of log variables are multiples of it."""
LOG_RATES = (0.4, 100.0)
"""Hz: slowest and fastest rate of [[logs]]."""


IMPORTED_MISSION = "operator"
"""Mission of an imported swarm: drones obey an operator, as those of Crazyswarm2 obey a script."""


@dataclass(frozen=True)
class SourceFiles:
    """The files of Crazyswarm2."""

    robots: Path
    """crazyflies.yaml."""
    mocap: Path | None = None
    """motion_capture.yaml; None: not given."""
    server: Path | None = None
    """server.yaml; None: not given."""


@dataclass
class ImportedSwarm:
    """The tables of a swarm file."""

    name: str
    """Name of the swarm."""
    drones: list[dict[str, Any]] = field(default_factory=list)
    """[[drones]]."""
    defaults: dict[str, Any] = field(default_factory=dict)
    """[defaults]."""
    logs: list[dict[str, Any]] = field(default_factory=list)
    """[[logs]]."""
    mocap: dict[str, Any] = field(default_factory=dict)
    """[mocap]."""
    control: dict[str, Any] = field(default_factory=dict)
    """[control]."""
    radio: dict[str, Any] = field(default_factory=dict)
    """[radio]."""
    fence: dict[str, Any] = field(default_factory=dict)
    """[fence]."""
    remarks: ImportRemarks = field(default_factory=ImportRemarks)
    """What was not taken over."""

    def format(self, files: SourceFiles) -> str:
        """Return the text of the swarm file, with the remarks as comments at its end."""
        blocks = [
            f"# From {files.robots.name} of Crazyswarm2, by `crazychoir import`.\n"
            f"name = {write_value(self.name)}\n"
            f"mission = {write_value(IMPORTED_MISSION)}  # obeys a script, the terminal or the page"
        ]
        tables = {
            "[fence]": self.fence,
            "[control]": self.control,
            "[radio]": self.radio,
            "[mocap]": self.mocap,
            "[defaults]": self.defaults,
        }
        blocks += [
            _format_table(head, table) for head, table in tables.items() if table
        ]
        blocks += [_format_table("[[drones]]", row) for row in self.drones]
        blocks += [_format_table("[[logs]]", row) for row in self.logs]
        if self.remarks.lines:
            blocks.append(
                "\n".join(
                    ["# Not taken over:", *(f"# {x}" for x in self.remarks.lines)]
                )
            )
        return "\n\n".join(blocks) + "\n"


def _format_table(head: str, table: Mapping[str, Any]) -> str:
    lines = [head]
    for key, value in table.items():
        if isinstance(value, Mapping):
            inner = ", ".join(
                f"{write_value(name)} = {write_value(x)}" for name, x in value.items()
            )
            lines.append(f"{key} = {{ {inner} }}")
        else:
            lines.append(f"{key} = {write_value(value)}")
    return "\n".join(lines)


def import_swarm(files: SourceFiles, name: str, is_virtual: bool) -> ImportedSwarm:
    """Return the swarm of the files.

    name: of the swarm
    is_virtual: whether to write the uris of virtual drones, and virtual cameras
    Raises ConfigError for a file that cannot be read, or has another structure.
    """
    swarm = ImportedSwarm(name)
    _RobotReader(files.robots, swarm, is_virtual).read()
    if files.mocap is not None:
        _read_mocap(files.mocap, swarm)
    if is_virtual:
        swarm.mocap = {}
    if files.server is not None:
        path, parameters = read_ros_parameters(files.server)
        swarm.remarks.add_rest(files.server.name, path, parameters, set())
    return swarm


class _RobotReader:
    """Reads crazyflies.yaml into a swarm."""

    def __init__(self, path: Path, swarm: ImportedSwarm, is_virtual: bool) -> None:
        self.path = path
        self.is_virtual = is_virtual
        self.swarm = swarm
        self.remarks = swarm.remarks
        self.raw = read_yaml(path)
        self.robots = find_table(self.raw, "robots", path.name)
        self.types = find_table(self.raw, "robot_types", path.name)
        self.common = find_table(self.raw, "all", path.name)
        if not self.robots:
            raise ConfigError(
                f"{path}: robots", "nothing", "one table a robot, with uri and type"
            )

    def read(self) -> None:
        """Read all robots."""
        known = {"robots", "robot_types", "all", "fileversion"}
        self.remarks.add_rest(self.path.name, "", self.raw, known)
        self.remarks.add_rest(self.path.name, "all", self.common, ALL_KEYS)
        for name, value in self._find_broadcasts().items():
            why = "no broadcasts: each drone gets packets of its own"
            self.remarks.add(self.path.name, f"all.broadcasts.{name}", value, why)
        flown = {
            name: table
            for name, table in self.robots.items()
            if self._is_flown(name, table)
        }
        ids = _choose_ids(list(flown))
        topics: dict[int, dict[str, Any]] = {}
        self.swarm.defaults = self._find_defaults()
        for k, (name, table) in enumerate(flown.items()):
            row = self._read_robot(name, table, ids[name])
            if self.is_virtual:
                row["uri"] = f"udp://127.0.0.1:{FIRST_PORT + k}"
            self.swarm.drones.append(row)
            topics[ids[name]] = self._find_topics(name, table)
        self.swarm.logs = self._build_logs(topics)
        self.swarm.fence = _build_fence([row["home"] for row in self.swarm.drones])
        self._choose_sender()
        if any(row.get("pose") == "onboard" for row in self.swarm.drones):
            self.swarm.radio = {"log_rate": LEAST_OWN_POSE_RATE}

    def _find_broadcasts(self) -> dict[str, Any]:
        return find_table(self.common, "broadcasts", f"{self.path.name}: all")

    def _is_flown(self, name: str, table: object) -> bool:
        """Return whether a robot is a drone with a radio."""
        if not isinstance(table, Mapping):
            raise ConfigError(
                f"{self.path}: robots.{name}", show_value(table), "a table"
            )
        if self._type_of(table, name).get("connection", "crazyflie") == "none":
            why = "no drone: objects that cameras see only are not in a swarm file"
            self.remarks.add(self.path.name, f"robots.{name}", table.get("type"), why)
            return False
        return True

    def _type_of(self, table: Mapping[str, Any], name: str) -> dict[str, Any]:
        kind = table.get("type")
        found = self.types.get(str(kind))
        if not isinstance(found, Mapping):
            raise ConfigError(
                f"{self.path}: robots.{name}.type",
                show_value(kind),
                f"one of robot_types: {', '.join(self.types) or 'there are none'}",
            )
        return dict(found)

    def _find_defaults(self) -> dict[str, Any]:
        parameters = self._find_parameters(self.common, "all")
        return {"parameters": parameters} if parameters else {}

    def _read_robot(
        self, name: str, table: Mapping[str, Any], i: int
    ) -> dict[str, Any]:
        key = f"robots.{name}"
        kind = str(table.get("type"))
        self.remarks.add_rest(self.path.name, key, table, ROBOT_KEYS)
        row: dict[str, Any] = {"id": i, "name": re.sub(r"[^A-Za-z0-9_.-]", "_", name)}
        row["home"] = self._find_place(table, key)
        row["uri"] = str(table.get("uri", "")).replace("radio://*/", "radio://0/")
        if table.get("enabled") is False:
            row["enabled"] = False
        row |= self._read_type(kind, self._type_of(table, name))
        parameters = self._find_parameters(
            self._type_of(table, name), f"robot_types.{kind}"
        ) | self._find_parameters(table, key)
        if parameters:
            row["parameters"] = parameters
        return row

    def _find_place(self, table: Mapping[str, Any], key: str) -> list[float]:
        place = table.get("initial_position")
        where = f"{self.path}: {key}.initial_position"
        if not isinstance(place, list) or len(place) != 3:
            raise ConfigError(where, show_value(place), "a place [x, y, z] in m")
        return [float(find_number(x, where)) for x in place]

    def _read_type(self, kind: str, table: dict[str, Any]) -> dict[str, Any]:
        """Return the keys of a drone that its type gives."""
        file = self.path.name
        key = f"robot_types.{kind}"
        self.remarks.add_rest(file, key, table, TYPE_KEYS)
        row: dict[str, Any] = {"platform": _find_platform(kind)}
        self.remarks.add(
            file, key, kind, f"platform {row['platform']} is taken: correct it if not"
        )
        connection = table.get("connection", KNOWN_CONNECTIONS[0])
        if connection not in KNOWN_CONNECTIONS:
            why = f"not known here; {KNOWN_CONNECTIONS[0]} is taken"
            self.remarks.add(file, f"{key}.connection", connection, why)
        if table.get("big_quad"):
            self.remarks.add(file, f"{key}.big_quad", True, "no such platform here")
        cameras = find_table(table, "motion_capture", f"{file}: {key}")
        self.remarks.add_rest(file, f"{key}.motion_capture", cameras, CAMERA_KEYS)
        if not cameras or cameras.get("enabled") is False:
            row["pose"] = "onboard"
        if cameras.get("tracking", "vendor") != "vendor" or "marker" in cameras:
            for name in ("tracking", "marker", "dynamics"):
                if name in cameras:
                    why = "define a rigid body with the drone's name in the camera software"
                    self.remarks.add(
                        file, f"{key}.motion_capture.{name}", cameras[name], why
                    )
        battery = find_table(table, "battery", f"{file}: {key}")
        self.remarks.add_rest(file, f"{key}.battery", battery, BATTERY_KEYS)
        if "voltage_warning" in battery:
            where = f"{file}: {key}.battery.voltage_warning"
            row["battery_warning"] = find_number(battery["voltage_warning"], where)
        if "voltage_critical" in battery:
            why = "a message there; battery_critical here lands the drone below it, under load"
            self.remarks.add(
                file,
                f"{key}.battery.voltage_critical",
                battery["voltage_critical"],
                why,
            )
        return row

    def _find_parameters(self, table: Mapping[str, Any], key: str) -> dict[str, float]:
        """Return the firmware parameters GROUP.NAME of a level; parameters that are set here are left out."""
        from crazychoir.radio.virtual.toc import read_firmware_names

        known = {entry.full: entry for entry in read_firmware_names()[1]}
        found: dict[str, float] = {}
        where = f"{self.path.name}: {key}"
        groups = find_table(table, "firmware_params", where)
        for group in groups:
            names = find_table(groups, group, f"{where}.firmware_params")
            for name, value in names.items():
                full = f"{group}.{name}"
                path = f"{key}.firmware_params.{full}"
                if full in SET_HERE:
                    self.remarks.add(self.path.name, path, value, SET_HERE[full])
                elif full not in known:
                    why = "not a parameter of the firmware of 2025.12"
                    self.remarks.add(self.path.name, path, value, why)
                elif self.is_virtual and not known[full].is_on_board(()):
                    why = f"virtual drones have no deck {known[full].deck}"
                    self.remarks.add(self.path.name, path, value, why)
                else:
                    found[full] = find_number(value, f"{self.path}: {path}")
        return found

    def _find_topics(self, name: str, table: Mapping[str, Any]) -> dict[str, Any]:
        """Return the topics with log variables of a robot: its own, else its type's, else those of all."""
        kind = str(table.get("type"))
        levels = {
            "all": self.common,
            f"robot_types.{kind}": self._type_of(table, name),
            f"robots.{name}": table,
        }
        found: dict[str, Any] = {}
        is_on = True
        for key, level in levels.items():
            logging = find_table(level, "firmware_logging", f"{self.path.name}: {key}")
            is_on = bool(logging.get("enabled", is_on))
            path = f"{key}.firmware_logging"
            self.remarks.add_rest(self.path.name, path, logging, LOGGING_KEYS)
            where = f"{self.path.name}: {path}"
            for topic, row in find_table(logging, "default_topics", where).items():
                if topic == "scan":
                    found[topic] = {**row, "vars": SCAN_VARIABLES}
                else:
                    why = DEFAULT_TOPICS.get(topic, "no equivalent")
                    self.remarks.add(
                        self.path.name, f"{path}.default_topics.{topic}", row, why
                    )
            found |= find_table(logging, "custom_topics", where)
        return found if is_on else {}

    def _build_logs(self, topics: dict[int, dict[str, Any]]) -> list[dict[str, Any]]:
        """Return the [[logs]]: one for each topic with the same variables and rate."""
        rows: dict[tuple[tuple[str, ...], float], list[int]] = {}
        for i, found in topics.items():
            for topic, row in found.items():
                where = f"{self.path}: custom_topics.{topic}"
                if not isinstance(row, Mapping) or not row.get("vars"):
                    raise ConfigError(
                        where, show_value(row), "a table with frequency and vars"
                    )
                asked = find_number(row.get("frequency", 10), f"{where}.frequency")
                rate = _round_rate(asked)
                if rate != asked:
                    why = f"{rate:g} Hz is taken: periods are multiples of 10 ms up to 2.5 s"
                    path = f"custom_topics.{topic}.frequency"
                    self.remarks.add(self.path.name, path, asked, why)
                rows.setdefault((tuple(map(str, row["vars"])), rate), []).append(i)
        return [
            {"variables": list(variables), "rate": rate}
            | ({} if len(ids) == len(topics) else {"drones": ids})
            for (variables, rate), ids in rows.items()
        ]

    def _choose_sender(self) -> None:
        """Let more than three drones of a dongle fly by places: a dongle does not stream to so many."""
        dongles: dict[str, int] = {}
        for row in self.swarm.drones:
            if row.get("enabled", True):
                dongle = row["uri"].removeprefix("radio://").partition("/")[0]
                dongle = "0" if row["uri"].startswith("udp://") else dongle
                dongles[dongle] = dongles.get(dongle, 0) + 1
        if max(dongles.values(), default=0) > SHARED_DRONES:
            self.swarm.control = {"sender": "xyz"}


def _choose_ids(names: list[str]) -> dict[str, int]:
    """Return the id of each robot: the number at the end of its name, if these differ, else 0, 1, 2 ..."""
    ends = [re.search(r"(\d{1,4})\Z", name) for name in names]
    numbers = [int(end[1]) for end in ends if end is not None]
    if len(set(numbers)) == len(names):
        return dict(zip(names, numbers, strict=True))
    return {name: k for k, name in enumerate(names)}


def _find_platform(kind: str) -> str:
    """Return the platform that the name of a type suggests."""
    words = kind.lower()
    if "bl" in re.split(r"[^a-z]|\d", words) or "brushless" in words:
        return "cf21bl"
    return "cf21thrust" if "thrust" in words else "cf21"


def _round_rate(asked: float) -> float:
    """Return the nearest rate in Hz that log variables can have."""
    low, high = LOG_RATES
    steps = round(1.0 / (min(max(asked, low), high) * LOG_STEP))
    rate = 1.0 / (steps * LOG_STEP)
    return asked if abs(rate - asked) < LOG_STEP * asked else round(rate, 4)


def _build_fence(homes: list[list[float]]) -> dict[str, Any]:
    """Return a fence around the homes."""
    low = [min(-LEAST_FENCE[c], *(p[c] - FENCE_MARGIN for p in homes)) for c in (0, 1)]
    high = [max(LEAST_FENCE[c], *(p[c] + FENCE_MARGIN for p in homes)) for c in (0, 1)]
    floor = min(0.0, *(p[2] for p in homes))
    top = max(LEAST_FENCE[2], *(p[2] + FENCE_MARGIN for p in homes))
    return {"min": [*low, floor], "max": [*high, top]}


def _read_mocap(path: Path, swarm: ImportedSwarm) -> None:
    """Read motion_capture.yaml: its type and address; all else is noted."""
    key, table = read_ros_parameters(path)
    kind = str(table.get("type", ""))
    if kind in CAMERA_TYPES:
        swarm.mocap["source"] = kind
    else:
        allowed = ", ".join(CAMERA_TYPES)
        swarm.remarks.add(
            path.name, f"{key}.type", kind, f"not known here; these are: {allowed}"
        )
    if "hostname" in table:
        swarm.mocap["hostname"] = str(table["hostname"])
    plain = {
        name: str(value)
        for name, value in table.items()
        if name not in ("type", "hostname") and isinstance(value, str | int | float)
    }
    if plain:
        swarm.mocap["options"] = plain
    known = {"type", "hostname", *plain}
    swarm.remarks.add_rest(path.name, key, table, known)
    assert set(swarm.mocap) <= set(MocapTable.__struct_fields__)  # noqa: S101 - keys of this file
