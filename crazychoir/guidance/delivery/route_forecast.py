"""The forecast of one robot: where its stops are, and when it will have served them."""

import math
from collections.abc import Sequence

import numpy as np

from crazychoir.config.tables import FlightTable
from crazychoir.guidance.delivery.commitments import Commitments
from crazychoir.planning.point_to_point import compute_rest_to_rest_time
from crazychoir.routing.instance.plan import Stop
from crazychoir.types import Vec


class RouteForecast:
    """Predicts when one robot will have served its stops.

    commitments: the route of the robot, and what it may begin.
    flight: limits of its flights.
    service_time: s at each stop.

    serving_until: time in s at which the present service ends.
    promised: time in s at which the route ends, as predicted when the plan was new.
    """

    def __init__(
        self, commitments: Commitments, flight: FlightTable, service_time: float
    ) -> None:
        self.commitments = commitments
        self.news = commitments.news
        self.flight = flight
        self.service_time = service_time
        self.serving_until = 0.0
        self.promised = np.inf

    def place(self, stop: Stop) -> Vec:
        """Return the place of a stop, (2,) m."""
        if stop.kind == "delivery":
            return np.array(self.news.book.tasks[stop.task].delivery)
        return np.array(self.news.standings()[stop.task].pickup)

    def seconds(self, route: Sequence[Stop]) -> float:
        """Return the time in s until a route, flown from here, has been served."""
        p = np.array(self.news.here())
        total = self._rest_of_service()
        for stop in route:
            goal = self.place(stop)
            total = total + self._leg(p, goal) + self.service_time
            p = goal
        return total

    def head(self, horizon: float) -> tuple[list[Stop], Vec, float]:
        """Return the stops that a new plan leaves to this robot, as (stops, place, seconds).

        They are the next stop, and the stops to which it sets out within the horizon. The list ends
        before the first stop that it may not begin, see Commitments.allow: if this robot has no plan
        from the last planning, another robot may have a route that contains this stop.

        horizon: s.
        Returns the stops, the place (2,) m of the last one (here, without stops), and the s until
        it has been served.
        """
        head: list[Stop] = []
        p = np.array(self.news.here())
        seconds = self._rest_of_service()
        for stop in self.commitments.route:
            if not self.commitments.allow(stop) or (head and seconds > horizon):
                break
            goal = self.place(stop)
            seconds += self._leg(p, goal) + self.service_time
            p = goal
            head.append(stop)
        return head, p, seconds

    def promise(self) -> None:
        """Store when the new route will have been served, for `is_late`."""
        self.promised = self.news.clock.now() + self.seconds(self.commitments.route)

    def is_late(self, allowed: float) -> bool:
        """Return whether the route will end later than predicted when it was new.

        allowed: s by which it may be later.
        """
        route = self.commitments.route
        return (
            bool(route)
            and self.news.clock.now() + self.seconds(route) > self.promised + allowed
        )

    def _rest_of_service(self) -> float:
        """Return the s that are left of the present service."""
        return max(0.0, self.serving_until - self.news.clock.now())

    def _leg(self, a: Vec, b: Vec) -> float:
        """Return the s of a flight from a place to another, (2,) m each."""
        return compute_rest_to_rest_time(
            math.dist(a, b), self.flight.speed_limit, self.flight.acceleration_limit
        )
