"""Notes of one robot on what its plannings could not do, and why."""

import logging
from typing import Any

from crazychoir.guidance.delivery.replanning import AUCTION_METHOD, PlanShare
from crazychoir.guidance.delivery.site import DeliverySite
from crazychoir.guidance.tasks.team_news import TeamNews

log = logging.getLogger(__name__)

NO_PLAN_REASON = "no plan: only goods on board are delivered"
"""Reason when all methods have failed."""
TOO_FAR_REASON = "no drone that can serve it has enough left of its route_length_limit"
"""Reason when no robot has enough range left."""


class PlanNotes:
    """Record which methods found no plan, and which tasks are left alone, with the reasons.

    news: the news of the robot.
    site: where goods may lie, and which robots may serve them.

    fallbacks: by planning, which method has failed, why, and what was done instead.
    unserved: why tasks are left alone, by the newest plan.
    """

    def __init__(self, news: TeamNews, site: DeliverySite) -> None:
        self.news = news
        self.site = site
        self.fallbacks: list[dict[str, Any]] = []
        self.unserved: dict[int, str] = {}

    def note(self, number: int, share: PlanShare, speaks: bool) -> None:
        """Record what a planning could not do.

        number: number of the planning, from 1 on.
        share: its result.
        speaks: whether this robot logs it.
        """
        self._note_trouble(number, share.trouble, speaks)
        unplanned = (
            f"{NO_PLAN_REASON}: {share.trouble[AUCTION_METHOD]}"
            if AUCTION_METHOD in share.trouble
            else ""
        )
        unserved = {j: unplanned or self._explain(j) for j in share.unserved}
        for j, why in unserved.items():
            if speaks and self.unserved.get(j) != why:
                log.warning("drone %d: task %d is left alone: %s", self.news.id, j, why)
        self.unserved = unserved

    def _note_trouble(self, number: int, trouble: dict[str, str], speaks: bool) -> None:
        """Record which methods have found no plan, and why."""
        for method, why in trouble.items():
            instead = (
                NO_PLAN_REASON
                if method == AUCTION_METHOD
                else f"planned by {AUCTION_METHOD}"
            )
            self.fallbacks.append(
                {"planning": number, "method": method, "why": why, "instead": instead}
            )
            if speaks:
                log.warning(
                    "drone %d: planning %d: %s: %s; %s",
                    self.news.id,
                    number,
                    method,
                    why,
                    instead,
                )

    def _explain(self, j: int) -> str:
        """Return why no robot serves a free task."""
        task = self.news.book.tasks[j]
        standing = self.news.standings()[j]
        site = self.site
        flying = self.news.book.alive(self.news.members)
        badly = site.explain_bad_place(task, standing.pickup, standing.robot)
        return (
            badly
            or site.explain_unservable(task)
            or site.explain_wait(task, flying)
            or TOO_FAR_REASON
        )
