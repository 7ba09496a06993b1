"""The service of one robot at its stops: when it may begin, and when it may leave."""

from typing import Any

from crazychoir.guidance.delivery.commitments import Commitments
from crazychoir.guidance.delivery.route_forecast import RouteForecast
from crazychoir.guidance.tasks.team_mission import PLAN_LOOK_INTERVAL
from crazychoir.routing.instance.plan import Stop


class StopService:
    """Serve the stops of one robot so that no task is served twice.

    commitments: the route of the robot, and what it may begin.
    forecast: learns until when the robot serves.
    service_time: s at each stop.
    recover: goods of a lost robot are fetched from its last place.

    served: the stops that count, in order.
    longest_wait: s: longest wait at a stop, for a plan or for the team.
    """

    def __init__(
        self,
        commitments: Commitments,
        forecast: RouteForecast,
        service_time: float,
        recover: bool,
    ) -> None:
        self.commitments = commitments
        self.news = commitments.news
        self.forecast = forecast
        self.service_time = service_time
        self.recover = recover
        self.served: list[dict[str, Any]] = []
        self.longest_wait = 0.0

    async def serve(self, stop: Stop) -> None:
        """Announce the stop, serve it, and return when the team knows."""
        if not await self.wait_for_permission(stop):
            return
        self.forecast.serving_until = self.news.clock.now() + self.service_time
        number = self.commitments.announce(stop)
        await self._pause(self.service_time)
        if await self._wait_for_witnesses(number, stop):
            self.served.append(
                {"task": stop.task, "kind": stop.kind, "place": self.news.here()}
            )

    async def wait_for_permission(self, stop: Stop) -> bool:
        """Wait above the stop while a plan may give it to another robot.

        Returns False if it is not the next stop any more.
        """
        since = self.news.clock.now()
        while self.commitments.next() == stop:
            if self.commitments.allow(stop):
                return True
            await self._pause(PLAN_LOOK_INTERVAL)
            self._note_wait(since)
        return False

    async def _wait_for_witnesses(self, number: int, stop: Stop) -> bool:
        """Wait until more than half of the team have received the announcement of a stop.

        Returns False if the stop does not count. A robot that is cut off takes a pickup back. If
        others may fetch what it carries, they decide about a delivery.
        """
        since = self.news.clock.now()
        while True:
            if self.news.known(number):
                return True
            if not self.news.quorate:
                if stop.kind == "pickup":
                    self.commitments.take_back(stop.task)
                return stop.kind == "delivery" and not self.recover
            await self._pause(PLAN_LOOK_INTERVAL)
            self._note_wait(since)

    def _note_wait(self, since: float) -> None:
        self.longest_wait = max(self.longest_wait, self.news.clock.now() - since)

    async def _pause(self, seconds: float) -> None:
        await self.news.clock.sleep(seconds, drone=self.news.id)
