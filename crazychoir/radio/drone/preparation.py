"""What a drone is told, and must answer, before it flies."""

from dataclasses import dataclass

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.own_estimate import OwnEstimate
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.link.firmware import ConnectedFirmware
from crazychoir.radio.protocol.crtp import FIRST_VERSIONS
from crazychoir.radio.protocol.handlers import RADIO_HANDLERS, RadioHandler
from crazychoir.radio.protocol.thrust import thrust_command_per_newton
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class DeckNames:
    """Names of the parameters for decks that locate a drone."""

    positioning: tuple[str, ...] = (
        "bcLighthouse4",
        "bcDWM1000",
        "bcLoco",
        "bcFlow2",
        "bcFlow",
    )
    """Decks that locate a drone."""
    common_frame: tuple[str, ...] = positioning[:3]
    """Positioning decks that give all drones one common frame."""


DECK_NAMES = DeckNames()


class Preparation:
    """Checks the firmware of a drone, and sets its parameters, its frame and its place.

    handler: translates the commands; it is told the thrust command a newton
    """

    def __init__(
        self, setup: DroneSetup, handler: RadioHandler, estimate: OwnEstimate
    ) -> None:
        self.release = ""
        """Release of the firmware; empty while unknown."""
        self.is_prepared = False
        """Whether the parameters are set."""
        self.is_placed = False
        """Whether the drone's estimator was started at the drone's pose."""
        self._setup = setup
        self._handler = handler
        self._estimate = estimate

    @property
    def is_done(self) -> bool:
        """Whether the drone is prepared and its estimator was started."""
        return self.is_prepared and self.is_placed

    def forget(self) -> None:
        """Forget what was done: the drone was started again."""
        self.release = ""
        self.is_prepared = False
        self.is_placed = False

    def find_version_problem(self, connection: Connection) -> ConfigError | None:
        """Return why the firmware does not know the packets that it would receive, or None."""
        setup = self._setup
        try:
            check_protocol(
                connection.version, setup.kind, setup.platform, f"drone {setup.drone}"
            )
        except ConfigError as error:
            return error
        return None

    async def check_release(
        self, firmware: ConnectedFirmware, refused: ConfigError | None
    ) -> str:
        """Return why the drone may only land; empty if it may fly.

        A drone that another program left in flight is accepted, but may only land.

        refused: reason that is known already
        Raises ConfigError if the drone stands and cannot be flown with its firmware.
        """
        if refused is None and not self.release:
            release = await firmware.release()
            try:
                self._learn_thrust(release)
                self.release = release
            except ConfigError as error:
                refused = error
        if refused is not None and not self._estimate.is_flying:
            raise refused
        return str(refused or "")

    def _learn_thrust(self, release: str) -> None:
        """Set the thrust command a newton.

        Raises ConfigError if it is not known for this release.
        """
        if self._handler.needs_thrust:
            setup = self._setup
            self._handler.thrust = thrust_command_per_newton(
                release,
                setup.platform,
                setup.config.radio.thrust_map,
                f"drone {setup.drone}",
            )

    async def prepare(self, firmware: ConnectedFirmware) -> None:
        """Set the parameters and, for a drone without cameras, start its estimator.

        This is done once, on the ground.
        """
        setup = self._setup
        await firmware.set_all({"stabilizer.estimator": 2} | self._handler.parameters)
        await firmware.set_all(setup.config.radio.parameters | setup.row.parameters)
        if not setup.seen_by_cameras:
            await self._require_frame(firmware)
            await self.place(firmware, np.array(setup.row.home), setup.row.yaw)
        self.is_prepared = True

    async def _require_frame(self, firmware: ConnectedFirmware) -> None:
        """Raise ConfigError if several drones have no common frame, unless [radio] allows drift.

        The frame of a flow deck is the drone's own, and drifts.
        """
        setup = self._setup
        if setup.config.radio.drift or len(setup.config.ids) == 1:
            return
        decks = [
            deck
            for deck in DECK_NAMES.positioning
            if await firmware.has(f"deck.{deck}")
        ]
        if any(deck in DECK_NAMES.common_frame for deck in decks):
            return
        found = f"{', '.join(decks) or 'no deck'} on board: its frame drifts from the frame of the others"
        do = "Set drift = true in [radio] if the mission tolerates drift, or let the cameras see the drone."
        if setup.row.uri.startswith("udp://"):
            do += " A virtual drone gets a deck from `crazychoir virtual`, started with this swarm file."
        raise ConfigError(
            f"drone {setup.drone}: pose",
            found,
            f"one of {', '.join(DECK_NAMES.common_frame)}",
            do,
        )

    async def place(self, firmware: ConnectedFirmware, p: Vec, yaw: float) -> None:
        """Start the drone's estimator at this pose, unless the drone flies.

        p: (3,) m
        yaw: rad
        """
        x, y, z = p.tolist()
        await firmware.set_all(
            {
                "kalman.initialX": x,
                "kalman.initialY": y,
                "kalman.initialZ": z,
                "kalman.initialYaw": yaw,
            }
        )
        if self._estimate.is_flying:
            return
        await firmware.set("kalman.resetEstimation", 1)
        await firmware.set("kalman.resetEstimation", 0)
        self.is_placed = True


def check_protocol(version: int, kind: str, platform: Platform, where: str) -> None:
    """Raise ConfigError, with the numbers, if the firmware does not know the packets for its drone.

    version: protocol version of the firmware; negative if it does not tell one
    kind: kind of command, as a swarm file names it
    where: name of the drone for errors
    """
    missing = _missing_forms(version, kind, platform)
    if not missing:
        return
    form = max(missing, key=FIRST_VERSIONS.__getitem__)
    others = ", ".join(
        other
        for other in RADIO_HANDLERS
        if not _missing_forms(version, other, platform)
    )
    found = f"version {version}" if version >= 0 else "no version"
    allowed = f"{FIRST_VERSIONS[form]} or newer, for {form} (sender {kind} on {platform.name})"
    do = "Write newer firmware" + (
        f", or choose another sender in [control]: {others}." if others else "."
    )
    raise ConfigError(f"{where}: protocol of its firmware", found, allowed, do)


def _missing_forms(version: int, kind: str, platform: Platform) -> list[str]:
    """Return the forms that are needed but unknown to the firmware."""
    forms = [RADIO_HANDLERS[kind].form] + ["arm"] * platform.firmware.needs_arming
    return [
        form
        for form in forms
        if form in FIRST_VERSIONS and version < FIRST_VERSIONS[form]
    ]
