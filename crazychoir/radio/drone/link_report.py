"""What an agent and observers are told about a drone and its link."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio import checks
from crazychoir.radio.drone.camera_view import CameraView
from crazychoir.radio.drone.current_link import CurrentLink
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.landing_repeater import LandingRepeater
from crazychoir.radio.drone.motor_switch import MotorSwitch
from crazychoir.radio.drone.own_estimate import LOG_NAMES, OwnEstimate
from crazychoir.radio.drone.preparation import Preparation
from crazychoir.radio.link.connection import AWAITING_LOG
from crazychoir.safety.identity.preflight_check import (
    GroundedDrone,
    find_arming_problems,
)
from crazychoir.types import Body, LinkStatus, Pose


@dataclass(frozen=True, slots=True)
class ProblemTexts:
    """Texts about a drone that may not take off."""

    wrong_body: str = ": correct the position of its body, out of sight of the cameras, or switch the drone off and on"
    """Advice for a drone with the wrong body."""
    motors_cut: str = (
        "its motors were cut: switch it off and on, and start the owner of its "
        "dongle (crazychoir-radio) again"
    )
    """Problem of a drone with motors that were cut."""


PROBLEM_TEXTS = ProblemTexts()


class LinkReport:
    """Finds why a drone may not take off, and publishes the state of its link and of its body."""

    def __init__(
        self,
        setup: DroneSetup,
        link: CurrentLink,
        estimate: OwnEstimate,
        view: CameraView,
        preparation: Preparation,
        motors: MotorSwitch,
        landing: LandingRepeater,
    ) -> None:
        self.has_flown = False
        """Whether the drone has flown since its start: it may stand away from its home then."""
        self._setup = setup
        self._link = link
        self._estimate = estimate
        self._view = view
        self._preparation = preparation
        self._motors = motors
        self._landing = landing

    def find_problems(self) -> list[str]:
        """Return why the drone may not take off."""
        link = self._link
        connection = link.connection
        if connection is None:
            return [link.problem or self._describe_opening()]
        is_flying = self._estimate.is_flying
        is_seen_by_cameras = self._setup.seen_by_cameras
        if not (self._preparation.is_done or is_flying):
            is_unseen = is_seen_by_cameras and self._view.pose.fresh() is None
            return ["the cameras do not see it" if is_unseen else "is being prepared"]
        found = self._find_faults()
        if is_flying:
            return found
        found += checks.link_problems(connection.latency, connection.answered)
        if is_seen_by_cameras:
            return found + self._find_pose_problems()
        return found + self._find_variance_problems()

    def _find_faults(self) -> list[str]:
        """Return the faults of the drone itself, which count in flight too."""
        estimate = self._estimate
        harm = self.describe_harm()
        found = [harm] if harm else checks.supervisor_problems(estimate.supervisor)
        begin = self._setup.platform.battery.begin
        found += checks.battery_problems(estimate.battery, begin)
        if fault := self._view.fault:
            found.append(fault + PROBLEM_TEXTS.wrong_body)
        if self._motors.is_cut:
            found.append(PROBLEM_TEXTS.motors_cut)
        return found

    def _describe_opening(self) -> str:
        """Return how far the link has come that is being opened."""
        if self._link.opening is None:
            return "is being connected"
        stage = self._link.opening.stage
        if stage == AWAITING_LOG and self._estimate.has_arrived:
            return "is being prepared"
        return f"is being connected, {stage} so far"

    def describe_harm(self) -> str:
        """Return what has damaged or locked the drone; empty if nothing has.

        For a virtual drone the text also tells how to restart it.
        """
        supervisor = self._estimate.supervisor
        harm = checks.describe_harm(supervisor)
        is_virtual = self._setup.row.uri.startswith("udp")
        if is_virtual and supervisor & SUPERVISOR_BITS.locked:
            return f"{harm} (`crazychoir virtual fault {self._setup.drone} reboot=1`)"
        return harm

    def _find_pose_problems(self) -> list[str]:
        """Return why the cameras' poses and the drone's own estimate do not fit."""
        own = None
        if (state := self._estimate.state) is not None:
            own = Pose(np.array([*state.p, *state.flat[6:10]]))
        homes = {}
        if not self.has_flown:
            config = self._setup.config
            homes = {j: np.array(config.drone(j).home) for j in config.topology.seen}
        i = self._setup.drone
        drones = {j: GroundedDrone(home, None, None) for j, home in homes.items()}
        drones[i] = GroundedDrone(homes.get(i), own, self._view.pose.fresh())
        return find_arming_problems(i, drones)

    def _find_variance_problems(self) -> list[str]:
        """Return why a drone without cameras does not know its position well enough."""
        variances = self._estimate.variances
        return checks.spread_problems(
            [variances.get(name, math.nan) for name in LOG_NAMES.variances]
        )

    def make_status(self) -> LinkStatus:
        """Return the state of the link for its agent and for observers."""
        way = self._link.connection
        known = {}
        if way is not None:
            known = {"latency": way.latency, "answered": way.answered, "rssi": way.rssi}
        return LinkStatus(
            self._link.state,
            self._link.silence,
            battery=float(self._estimate.battery),
            supervisor=self._estimate.supervisor,
            flying=self._estimate.is_flying,
            problems=self.find_problems(),
            release=self._preparation.release,
            refused=self._landing.refused_plans,
            reconnected=self._link.reconnected,
            astray=self._view.fault,
            **known,
        )

    def publish(self) -> None:
        """Publish the state of the link and of the body."""
        is_flying = self._estimate.is_flying
        self.has_flown = self.has_flown or is_flying
        port = self._setup.port
        port.publish(DRONE_TOPICS.link, self.make_status())
        # Before the first log it is unknown whether the drone flies.
        if self._estimate.state_ns:
            port.publish(
                DRONE_TOPICS.body,
                Body(self.describe_harm(), is_flying and not self._motors.is_cut),
            )
