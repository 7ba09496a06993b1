"""A run of a swarm in real time that a program starts, in processes of its own."""

import contextlib
import json
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import msgspec

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, ProcessFailed, Refused
from crazychoir.files.private_folder import scratch_folder
from crazychoir.launch.processes import END_GRACE
from crazychoir.launch.run_registry import list_runs_of_file
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.radio.virtual.control import ask_server

CHILD_MODULE = "crazychoir.api.running.child_command"
"""Module that runs as a command, and ends with this program."""
LANDING_TIME = 60.0
"""s for the drones to land and for the run to end, before it is told to end, then killed."""
LOOK_INTERVAL = 0.05
"""s between two looks for the run in the registry."""
START_TIMEOUT = 180.0
"""s in which a run must be found; the first one compiles its laws."""
SHOWN_LINES = 12
"""Last lines of the log of a run that an error shows."""
DRONES_PER_DONGLE = 3
"""Number of virtual Crazyflies behind one modelled dongle."""
VIRTUAL_SENDER = "xyz"
"""Sender of virtual Crazyflies: places, few enough for a dongle with three drones."""
VIRTUAL_PLATFORM = "cf21"
"""Platform of virtual Crazyflies, where the swarm has the model of the paper, which has no firmware."""
VIRTUAL_HOST = "127.0.0.1"
"""Host of virtual Crazyflies."""


@dataclass(frozen=True, slots=True)
class BodyKinds:
    """What a run may fly."""

    simulated: str = "sim"
    """The bodies that the swarm file names; by default simulated ones."""
    virtual: str = "virtual"
    """Virtual Crazyflies: a model of the firmware behind cflib."""


BODY_KINDS = BodyKinds()


class SwarmRun:
    """A run that this program has started.

    config: the swarm
    bodies: one of BODY_KINDS
    processes: number of processes, None: as the swarm file says
    record: new file to record into, None for none
    Raises ConfigError for unknown bodies, ProcessFailed if the run does not start.
    """

    def __init__(
        self,
        config: SwarmConfig,
        bodies: str,
        processes: int | None = None,
        record: str | Path | None = None,
    ) -> None:
        if bodies not in (BODY_KINDS.simulated, BODY_KINDS.virtual):
            allowed = f'"{BODY_KINDS.simulated}" or "{BODY_KINDS.virtual}"'
            raise ConfigError("launch: bodies", bodies, allowed)
        is_virtual = bodies == BODY_KINDS.virtual
        flown = with_virtual_bodies(config) if is_virtual else config
        self._kept = ExitStack()
        self._bodies: subprocess.Popen[str] | None = None
        with ExitStack() as undone:
            undone.callback(self._kept.close)
            folder = self._kept.enter_context(
                scratch_folder(f"crazychoir-{flown.name}-")
            )
            self._log = folder / "run.log"
            file = folder / "swarm.json"
            file.write_text(flown.dumps(), encoding="utf-8")
            if is_virtual:
                self._bodies = self._start("virtual", "--swarm", str(file))
                undone.callback(self._end_bodies)
                self._wait_for_bodies(flown.mocap.port)
            options = [] if processes is None else ["--processes", str(processes)]
            if record is not None:
                options += ["--record", str(Path(record).resolve())]
            self._process = self._start("run", str(file), *options)
            undone.callback(self._interrupt)
            self.file = self._find(file)
            """Swarm file of this flight, by which the run is found."""
            undone.pop_all()

    def _start(self, *words: str) -> subprocess.Popen[str]:
        log: IO[str] = self._kept.enter_context(self._log.open("a", encoding="utf-8"))
        return subprocess.Popen(
            [sys.executable, "-m", CHILD_MODULE, *words, "--json"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            start_new_session=True,  # Ctrl-C is for this program, which lands the drones
        )

    def _wait_for_bodies(self, port: int) -> None:
        """Wait until the virtual Crazyflies answer at this UDP port."""
        bodies = self._bodies
        for _ in range(round(START_TIMEOUT / LOOK_INTERVAL)):
            with contextlib.suppress(Refused, ConnectionError):
                ask_server({"ask": "state"}, port=port)
                return
            if bodies is None or bodies.poll() is not None:
                break
            time.sleep(LOOK_INTERVAL)
        raise ProcessFailed("virtual Crazyflies", self._explain_failure(""))

    def _find(self, file: Path) -> str:
        """Wait until the run is in the registry, and return its swarm file."""
        for _ in range(round(START_TIMEOUT / LOOK_INTERVAL)):
            if found := list_runs_of_file(file):
                return found[0].file
            if self.has_ended():
                break
            time.sleep(LOOK_INTERVAL)
        said = self._wait_for_end() if self.has_ended() else ""
        raise ProcessFailed("the run", self._explain_failure(said))

    def _explain_failure(self, said: str) -> str:
        """Return why the run has failed: its answer, else the end of its log."""
        try:
            return str(json.loads(said)["reason"])
        except (ValueError, KeyError, TypeError):
            lines = self._log.read_text(encoding="utf-8").splitlines()
            return "\n".join(lines[-SHOWN_LINES:]) or "no sign of life"

    def end(self) -> dict[str, Any]:
        """Wait until the run has ended, and return its result.

        A run that does not end lands its drones by itself, and is ended.
        """
        try:
            said = self._wait_for_end()
        finally:
            self._end_bodies()
        try:
            result: dict[str, Any] = json.loads(said)
        except ValueError as error:
            raise ProcessFailed("the run", self._explain_failure(said)) from error
        finally:
            self._kept.close()
        return result

    def has_ended(self) -> bool:
        """Return whether the run has ended, by itself or by a failure."""
        return self._process.poll() is not None

    def _wait_for_end(self) -> str:
        """Wait for the end of the run, end it if it takes too long; return what it has printed."""
        for ending in (signal.SIGTERM, signal.SIGKILL):
            try:
                return self._process.communicate(timeout=LANDING_TIME)[0]
            except subprocess.TimeoutExpired:
                self._process.send_signal(ending)
        return self._process.communicate()[0]

    def _interrupt(self) -> None:
        """End a run that has not begun well."""
        self._process.send_signal(signal.SIGTERM)
        self._wait_for_end()

    def _end_bodies(self) -> None:
        """End the virtual Crazyflies, also on a machine too busy for them to end by themselves."""
        bodies = self._bodies
        if bodies is None:
            return
        self._bodies = None
        bodies.send_signal(signal.SIGINT)
        try:
            bodies.communicate(timeout=END_GRACE)
        except subprocess.TimeoutExpired:
            bodies.kill()
            bodies.communicate()


def with_virtual_bodies(config: SwarmConfig) -> SwarmConfig:
    """Return the same swarm with virtual Crazyflies on free UDP ports of this machine.

    They fly places by their planner on board, unless the swarm names another sender.
    """
    poses, *ports = find_free_ports(len(config.ids) + 1)
    drones = [
        {
            **msgspec.to_builtins(drone),
            "uri": f"udp://{VIRTUAL_HOST}:{port}",
            "platform": VIRTUAL_PLATFORM
            if drone.platform == PAPER_PLATFORM.name
            else drone.platform,
            "dongle": k // DRONES_PER_DONGLE,
        }
        for k, (drone, port) in enumerate(zip(config.drones, ports, strict=True))
    ]
    cameras = {
        **msgspec.to_builtins(config.mocap),
        "source": "virtual",
        "hostname": VIRTUAL_HOST,
        "port": poses,
    }
    control = msgspec.to_builtins(config.control)
    control["sender"] = config.control.sender or VIRTUAL_SENDER
    return config.replace(drones=drones, mocap=cameras, control=control)


def find_free_ports(count: int) -> list[int]:
    """Return free UDP ports of this machine."""
    with ExitStack() as held:
        doors = [
            held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            for _ in range(count)
        ]
        for door in doors:
            door.bind((VIRTUAL_HOST, 0))
        return sorted(door.getsockname()[1] for door in doors)
