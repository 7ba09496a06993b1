"""Requests of operators for the firmware of a drone, at rest or in flight: parameters, trajectories on board."""

import contextlib
import math
from collections.abc import Awaitable, Callable, Iterator, Mapping
from typing import Any

import numpy as np

from crazychoir.control.firmware import LINE_LATENESS, SetPointLead
from crazychoir.control.velocity import FIRMWARE_GAINS
from crazychoir.errors import ConfigError, LinkFailed, Refused
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.upload import fit_upload
from crazychoir.radio.drone.current_link import CurrentLink
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.link.firmware import ConnectedFirmware
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import XYZ, Vec

TRAJECTORY_SLOT = 0
"""Slot of the trajectory on board; a new upload replaces the last one."""
FOLLOWED_DISTANCE = 0.2
"""m: a line that ends nearer than this to the agent's line for the trajectory is flown on board."""
FOLLOWED_DELAYS = (0.0, 0.04, 0.08, 0.12)
"""s by which the agent may be behind the drone, as the answer to it and its lines take their time."""
STRAY_DISTANCE = 0.5
"""m: a drone further from the trajectory than this, beside its lag, does not fly it."""
MOST_PARAMETERS = 40
"""Most parameters that are read at once."""
FIRMWARE_VERBS = (
    "firmware_get",
    "firmware_set",
    "firmware_list",
    "trajectory_upload",
    "trajectory_start",
)
"""Verbs of the requests."""
Arguments = dict[str, Any]


class OnBoardTrajectory:
    """A trajectory that the planner on board flies by itself, while its agent follows it in time.

    Lines that lead along the trajectory need no packet. A line to another place, or any other
    command, ends it. A drone that is far from the trajectory does not fly it.
    """

    def __init__(self, setup: DroneSetup) -> None:
        self._clock = setup.clock
        self._path: Piecewise | None = None
        self._lead = SetPointLead()
        self._began_ns = 0
        self._is_waiting = False

    @contextlib.contextmanager
    def beginning(self, path: Piecewise) -> Iterator[None]:
        """Keep lines back while the drone is told to begin this path, in the world.

        A line would end the trajectory. After an error the drone is flown by lines again.
        """
        self._path = path
        self._lead = SetPointLead()
        self._is_waiting = True
        try:
            yield
        except BaseException:
            self._path = None
            raise
        finally:
            self._is_waiting = False
            self._began_ns = self._clock.now_ns()

    def covers(self, command: object, here: Vec | None) -> bool:
        """Return whether the drone flies this command by itself; otherwise the trajectory is over.

        here: (3,) m, position of the drone; None if it is not known
        """
        path = self._path
        if path is None:
            return False
        if isinstance(command, XYZ) and command.verb == "line":
            is_covered = self._is_waiting or self._follows(path, command, here)
        else:
            is_covered = False
        if not is_covered:
            self._path = None
        return is_covered

    def _follows(self, path: Piecewise, line: XYZ, here: Vec | None) -> bool:
        """Return whether drone and line are where they are on this path."""
        now = self._clock.now()
        t = (self._clock.now_ns() - self._began_ns) / NS_PER_SECOND
        if t >= path.duration:
            return False
        wanted = path.sample(t)
        lag = float(np.linalg.norm(wanted.v)) / FIRMWARE_GAINS.position
        if here is not None and math.dist(here, wanted.p) > STRAY_DISTANCE + lag:
            return False
        later = float(line.flat[4]) + LINE_LATENESS
        for delay in FOLLOWED_DELAYS:
            end = self._lead.apply(path.sample(t - delay).flat, later, now)
            if end is not None and (
                math.dist(end[0:3], line.flat[0:3]) < FOLLOWED_DISTANCE
            ):
                return True
        return False


class FirmwareAccess:
    """Carries out requests for the firmware of one drone.

    on_board: is told when a trajectory on board begins
    """

    def __init__(
        self, setup: DroneSetup, link: CurrentLink, on_board: OnBoardTrajectory
    ) -> None:
        self._on_board = on_board
        self._setup = setup
        self._link = link
        methods = (self._get, self._set, self._list, self._upload, self._start)
        self.requests: Mapping[str, Callable[[Arguments], Awaitable[Any]]] = dict(
            zip(FIRMWARE_VERBS, methods, strict=True)
        )
        """Requests by verb."""

    def _firmware(self) -> ConnectedFirmware:
        if self._link.connection is None:
            why = self._link.problem or self._link.why or "it is not connected"
            raise Refused(f"drone {self._setup.drone}", why)
        return ConnectedFirmware(self._link.connection)

    def _refuse(self, error: LinkFailed | ConfigError) -> Refused:
        return Refused(f"drone {self._setup.drone}", str(error))

    async def _get(self, arguments: Arguments) -> dict[str, float]:
        """Return the values of a parameter, or of all of a group."""
        firmware = self._firmware()
        try:
            names = firmware.list_names(str(arguments["name"]))
            return {name: await firmware.get(name) for name in names[:MOST_PARAMETERS]}
        except LinkFailed as error:
            raise self._refuse(error) from error

    async def _set(self, arguments: Arguments) -> dict[str, float]:
        """Set a parameter, and return the value that the firmware then has."""
        firmware = self._firmware()
        name = str(arguments["name"])
        try:
            await firmware.set(name, float(arguments["value"]))
            return {name: await firmware.get(name)}
        except LinkFailed as error:
            raise self._refuse(error) from error
        except (TypeError, ValueError):
            raise Refused(
                f"drone {self._setup.drone}",
                f"parameter {name} = {arguments['value']!r}: a number is allowed",
            ) from None

    async def _list(self, arguments: Arguments) -> dict[str, tuple[str, bool]]:
        """Return the type of each parameter, and whether it can be set; no packet is sent."""
        return self._firmware().describe_parameters()

    async def _upload(self, arguments: Arguments) -> str:
        """Upload a trajectory into the memory of the drone."""
        firmware = self._firmware()
        if self._setup.kind != "xyz":
            raise Refused(
                f"drone {self._setup.drone}",
                f'its sender is "{self._setup.kind}"; a trajectory on board needs "xyz"',
            )
        try:
            path = Piecewise(arguments["coefficients"], arguments["durations"])
            upload = fit_upload(path)
            pieces = len(upload.pieces.durations)
            await firmware.upload(upload.memory, TRAJECTORY_SLOT, pieces)
        except (LinkFailed, ConfigError) as error:
            raise self._refuse(error) from error
        return f"{pieces} pieces, {len(upload.memory)} bytes"

    async def _start(self, arguments: Arguments) -> str:
        """Start the uploaded trajectory; `coefficients` and `durations` say how it is flown in the world."""
        firmware = self._firmware()
        path = Piecewise(arguments["coefficients"], arguments["durations"])
        try:
            with self._on_board.beginning(path):
                await firmware.start(
                    TRAJECTORY_SLOT,
                    float(arguments["timescale"]),
                    bool(arguments["relative"]),
                    bool(arguments["reversed"]),
                )
        except LinkFailed as error:
            raise self._refuse(error) from error
        return "started"
