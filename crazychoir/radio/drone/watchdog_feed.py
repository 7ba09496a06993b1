"""The emergency-stop watchdog of a drone, which needs a packet now and then."""

from crazychoir.radio.drone.current_link import CurrentLink
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.own_estimate import OwnEstimate
from crazychoir.radio.drone.timing import REPEAT_RULES
from crazychoir.radio.protocol.crtp import PACKET_FORMS
from crazychoir.runtime.clock import NS_PER_SECOND


class WatchdogFeed:
    """Feeds the emergency-stop watchdog of a drone from its first flight on."""

    def __init__(
        self, setup: DroneSetup, link: CurrentLink, estimate: OwnEstimate
    ) -> None:
        self.is_started = False
        """Whether the watchdog on board runs: it must be fed from then on."""
        self._is_wanted = setup.config.radio.watchdog and setup.kind == "xyz"
        self._clock = setup.clock
        self._link = link
        self._estimate = estimate
        self._due_ns = 0

    def feed(self) -> None:
        """Feed the emergency-stop watchdog if [radio] watchdog is set.

        Without this process the drone then cuts its motors.
        """
        now_ns = self._clock.now_ns()
        self.is_started = self.is_started or (
            self._is_wanted and self._estimate.is_flying
        )
        # Once started it must be fed, on the ground too.
        if self.is_started and now_ns >= self._due_ns:
            self._due_ns = now_ns + round(REPEAT_RULES.watchdog_period * NS_PER_SECOND)
            self._link.send_all([PACKET_FORMS["emergency_stop_watchdog"].packet()])
