"""A drone as the cameras see it: it is told its pose, and its take-off is watched."""

import math
from dataclasses import dataclass

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.errors import CodecError
from crazychoir.mocap.view import RateLimit
from crazychoir.radio.drone.current_link import CurrentLink
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.own_estimate import OwnEstimate
from crazychoir.radio.drone.pose_broadcast import PoseBroadcast, ToldPose
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.protocol.handlers import pose_packet, position_packet
from crazychoir.radio.protocol.packed_poses import NumberedPose
from crazychoir.radio.visibility import SIGHT_LIMITS, BodySights, TakeOffWatch
from crazychoir.runtime.mailbox import Call, Latest
from crazychoir.safety.identity.pose_gate import PoseGate
from crazychoir.types import Pose


@dataclass(frozen=True, slots=True)
class CameraPoseLimits:
    """How old, rare or jumping the cameras' poses of a drone may be."""

    oldest_sent: float = 0.1
    """s: a drone is not told a pose that is older."""
    largest_error: float = 0.2
    """m: a drone that believes itself further away from the cameras' pose may have missed broadcasts.
    It is also sent its own pose, which it acknowledges.
    """
    oldest_used: float = 1.0
    """s for which the last pose from the cameras is used as the drone's position."""
    longest_jump: float = 0.1
    """s of jumping poses after which the check of the take-off is given up."""
    longest_gap: float = 0.5
    """s without a pose after which the drone counts as not seen, at any rate of poses."""


CAMERA_POSE_LIMITS = CameraPoseLimits()


class CameraView:
    """Takes the cameras' poses of one drone, and tells them to the drone's estimator.

    sights: bodies that the cameras see, shared by all drones of the process; None: the drone makes
      its own
    broadcast: tells the poses of all drones of the dongle; None: the drone is sent its own
    """

    def __init__(
        self,
        setup: DroneSetup,
        link: CurrentLink,
        estimate: OwnEstimate,
        sights: BodySights | None,
        broadcast: PoseBroadcast | None = None,
    ) -> None:
        self.place: tuple[float, Pose] | None = None
        """Time in s and pose at which the cameras last saw the drone, among accepted poses."""
        self.pose: Latest[Pose] = Latest(
            setup.clock, f"drone {setup.drone} pose", CAMERA_POSE_LIMITS.longest_gap
        )
        """Last pose from the cameras, accepted or not."""
        self.gate = PoseGate()
        """Tells poses of the drone from those of other bodies."""
        self.take_off: TakeOffWatch | None = None
        """Watch of the take-off; None for a drone without cameras."""
        self.malformed = 0
        """Count of poses that do not fit into a packet."""
        self._setup = setup
        self._clock = setup.clock
        self._link = link
        self._estimate = estimate
        self._broadcast = broadcast
        self._told = RateLimit(setup.config.radio.pose_rate)
        self._jumped_at = math.inf
        if setup.seen_by_cameras:
            self._subscribe(sights)

    def _subscribe(self, sights: BodySights | None) -> None:
        setup = self._setup
        bus = setup.bus
        here = setup.port.address
        self.take_off = TakeOffWatch(
            setup.drone, sights or BodySights(bus, setup.config, here)
        )
        for mailbox in (self.pose, Call(self._clock, self.see, "pose")):
            bus.subscribe(
                DRONE_TOPICS.pose,
                PORT_ADDRESSES.camera_offset + setup.drone,
                here,
                mailbox,
                SIGHT_LIMITS.pose_rate,
            )

    def see(self, pose: Pose, age: float) -> None:
        """Take a pose from the cameras, and send it to the drone's estimator.

        With this estimate the drone lands if this process fails.

        age: s
        """
        now = self._clock.now()
        if not self.gate.believes(pose, now, self._estimate.is_flying):
            self._note_jump(now)
            return
        self.place = (now - age, pose)
        self._jumped_at = math.inf
        take_off = self.take_off
        if take_off is not None and take_off.found:
            return  # the drone lands with its own sensors
        connection = self._link.connection
        if age <= CAMERA_POSE_LIMITS.oldest_sent and connection is not None:
            try:
                self._tell(connection, pose, now - age)
            except CodecError:
                self.malformed += 1

    def _tell(self, connection: Connection, pose: Pose, made: float) -> None:
        """Tell the drone its pose; while its take-off is watched only its position.

        made: s: when the cameras saw it
        Raises CodecError if it does not fit into a packet.
        """
        is_watched = self.take_off is not None and self.take_off.watched
        if self._broadcast is not None:
            row = NumberedPose(self._setup.number, pose, not is_watched)
            self._broadcast.tell(ToldPose(row, made, connection, self._setup))
            if not self._is_lost(pose):
                return
        if self._told.passes(self._clock.now()):
            connection.newest(
                "pose", position_packet(pose) if is_watched else pose_packet(pose)
            )

    def _is_lost(self, pose: Pose) -> bool:
        """Return whether the drone believes itself elsewhere."""
        state = self._estimate.state
        return (
            state is not None
            and math.dist(state.p, pose.p) > CAMERA_POSE_LIMITS.largest_error
        )

    def _note_jump(self, now: float) -> None:
        """Note a pose that the gate does not believe.

        now: s
        """
        self._setup.warn(
            "jump",
            "its pose jumps (another body, or an error of the cameras): it is not sent to the estimator",
        )
        self._jumped_at = min(self._jumped_at, now)
        if (
            self.take_off is not None
            and now - self._jumped_at > CAMERA_POSE_LIMITS.longest_jump
        ):
            self.take_off.give_up()

    @property
    def fault(self) -> str:
        """Fault of the last take-off: the body does not move as the drone does; empty if none."""
        return "" if self.take_off is None else self.take_off.found

    def find_recent_pose(self) -> Pose | None:
        """Return the last accepted pose; None if there is none, or it is too old to be used."""
        if (
            self.place is not None
            and self._clock.now() - self.place[0] < CAMERA_POSE_LIMITS.oldest_used
        ):
            return self.place[1]
        return None

    def forget_fault(self) -> None:
        """Forget the fault of the last take-off, because the drone was started again."""
        if self.take_off is not None:
            self.take_off.found = ""

    def forgive_fault(self) -> None:
        """Forget the fault of the last take-off once the cameras no longer see the landed drone.

        To put a body right, the user takes it out of the cameras' sight. The next take-off checks
        it again.
        """
        if (
            self.take_off is not None
            and not self._estimate.is_flying
            and self.pose.fresh() is None
        ):
            self.take_off.found = ""
