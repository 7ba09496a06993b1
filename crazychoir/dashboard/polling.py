"""Data that no topic carries, requested while a page is open: tasks, routes, simulated networks."""

import asyncio
import math
from dataclasses import dataclass
from typing import Any

from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.config.network import rules_in_words
from crazychoir.dashboard.commands import CommandDesk
from crazychoir.dashboard.model import SwarmModel
from crazychoir.dashboard.receipts import Receipt
from crazychoir.dashboard.recent_loss import RecentCounts, lost_share
from crazychoir.runtime.actor import Actor
from crazychoir.team.graph import describe_ids


@dataclass(frozen=True, slots=True)
class PollingLimits:
    """Rates and limits of the requests to drones while a page is open."""

    overview_rate: float = 8.0
    """Hz: requests for an overview, to one drone after the other."""
    task_rate: float = 1.0
    """Hz: requests for the list of tasks, to one drone."""
    no_tasks_pause: float = 10.0
    """Seconds before a swarm without tasks is asked for tasks again."""
    answer_timeout: float = 0.8
    """Seconds to wait for an answer to such a request."""
    shortest_loss_window: float = 4.0
    """Shortest time in seconds over which a share of lost messages is taken.

    It is longer if two turns through all drones take longer.
    """
    most_asked_drones: int = 3
    """Most drones that get a task request, one after the other, until a drone accepts it."""


POLLING_LIMITS = PollingLimits()


class Overview(Actor):
    """Overviews that the drones send, one drone after the other.

    `lost`: share of messages that the simulated network lost recently, by edge (i, j), i < j, both
        directions together.
    `routes`: by drone, the places to which it is to fly, m.
    `networks`: by drone, what it simulates, see Impairment.
    """

    name = "overview"

    def __init__(self, desk: CommandDesk) -> None:
        self.desk = desk
        self.ids = desk.place.config.ids
        self.watched = False
        self.lost: dict[tuple[int, int], float] = {}
        self.routes: dict[int, list[list[float]]] = {}
        self.networks: dict[int, dict[str, Any]] = {}
        self._of: dict[tuple[int, int], RecentCounts] = {}

    async def run(self) -> None:
        """Ask the drones in turn; forget route and network of a drone that does not answer."""
        k = 0
        window = max(
            POLLING_LIMITS.shortest_loss_window,
            2.0 * len(self.ids) / POLLING_LIMITS.overview_rate,
        )
        async for _ in self.desk.place.clock.ticks(POLLING_LIMITS.overview_rate):
            if not self.watched:
                continue
            i = self.ids[k % len(self.ids)]
            k += 1
            answer = await _answer_of_drone(self.desk, i, "overview")
            self.routes.pop(i, None)
            self.networks.pop(i, None)
            if answer is None:
                continue
            self.networks[i] = answer["network"]
            if answer["route"]:
                self.routes[i] = [[round(x, 2) for x in p] for p in answer["route"]]
            for j, (sent, lost) in answer["links"].items():
                self._note(i, j, sent, lost, window)

    def news(self) -> dict[str, Any]:
        """Return the part of the pages' news that comes from overviews."""
        links = {f"{i}-{j}": round(lost, 3) for (i, j), lost in self.lost.items()}
        return {"links": links, "routes": self.routes, "network": self._network()}

    def _network(self) -> dict[str, Any] | None:
        """Return the simulated network: the rules of the first drone, and a description.

        The description names the drones if they simulate different networks.
        """
        same: dict[str, list[int]] = {}
        for i in sorted(self.networks):
            same.setdefault("; ".join(rules_in_words(self.networks[i])), []).append(i)
        if not same:
            return None
        words = [
            text if len(same) == 1 else f"drones {describe_ids(ids)}: {text}"
            for text, ids in same.items()
        ]
        return {
            "rules": self.networks[min(self.networks)]["rules"],
            "words": " | ".join(words),
        }

    def _note(self, i: int, j: int, sent: int, lost: int, window: float) -> None:
        self._of.setdefault((i, j), RecentCounts(window)).note(
            self.desk.place.clock.now(), sent, lost
        )
        both = [self._of[pair] for pair in ((i, j), (j, i)) if pair in self._of]
        self.lost[min(i, j), max(i, j)] = lost_share(*both)


class TaskBoard(Actor):
    """The tasks of a mission, and requests to add and cancel them."""

    name = "tasks"

    def __init__(self, desk: CommandDesk, model: SwarmModel) -> None:
        self.desk = desk
        self.ids = desk.place.config.ids
        self.model = model
        self.watched = False
        self.tasks: list[dict[str, Any]] | None = None
        """The list in the form of TaskSource; None for a mission without tasks."""
        self._k = 0
        self._again = -math.inf
        self._asking: dict[asyncio.Task[Receipt], None] = {}

    async def run(self) -> None:
        """Ask one drone regularly, the next one if it does not answer."""
        async for _ in self.desk.place.clock.ticks(POLLING_LIMITS.task_rate):
            if self.watched and self.desk.place.clock.now() >= self._again:
                await self.look()

    async def look(self) -> None:
        """Ask for the list of tasks.

        Ask the drone that was asked last. If it hears no more than half of the swarm, it may be in
        a part that is cut off: then ask the next drone that hears more, if there is one.
        """
        n = len(self.ids)
        steps = (
            k
            for k in range(n)
            if 2 * self.model.heard_by(self.ids[(self._k + k) % n]) > n
        )
        self._k += next(steps, 0)
        answer = await _answer_of_drone(
            self.desk, self.ids[self._k % len(self.ids)], "task_list"
        )
        if answer is None:
            self._k += 1
            if self._k % len(self.ids) == 0:
                self._again = (
                    self.desk.place.clock.now() + POLLING_LIMITS.no_tasks_pause
                )
        else:
            self.tasks = answer["tasks"]

    def begin(self, verb: str, words: str, **arguments: Any) -> None:
        """Start `ask` without waiting: the page that wants it may be closed before it is done."""
        task = asyncio.get_running_loop().create_task(
            self.ask(verb, words, **arguments)
        )
        self._asking[task] = None
        task.add_done_callback(lambda done: self._asking.pop(done, None))

    async def ask(self, verb: str, words: str, **arguments: Any) -> Receipt:
        """Ask one drone, then others if it refuses.

        A drone that has accepted the request, or does not answer, may have done it or may still
        do it. No other drone is asked then.
        """
        first = self._k % len(self.ids)
        for i in [*self.ids[first:], *self.ids[:first]][
            : POLLING_LIMITS.most_asked_drones
        ]:
            receipt = self.desk.order(verb, [i], words=words, each=lambda i: arguments)
            await self.desk.settled(receipt)
            if receipt.answers[i][0] != ANSWER_TEXTS.refused:
                break
        self._again = -math.inf
        await self.look()
        return receipt


async def _answer_of_drone(desk: CommandDesk, i: int, verb: str) -> Any:
    """Return the answer of drone i; None if it refuses or does not answer."""
    try:
        answer = await desk.place.commander.request(
            i, verb, POLLING_LIMITS.answer_timeout
        )
    except TimeoutError:
        return None
    return answer.detail if answer.kind == ANSWER_TEXTS.done else None
