"""Join a running swarm: the window through which an observer or operator sees its network."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from crazychoir.bus.commands import (
    ANSWER_TEXTS,
    Answer,
    Commander,
)
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import Topic
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, Refused
from crazychoir.launch.emergency import ABSENT_ANSWER, EmergencyStop
from crazychoir.launch.network import REPLAY_HOST, make_observer_link, run_attached
from crazychoir.launch.running_swarm import (
    NEXT_PROCESS_TIMEOUT,
    SWARM_SEARCH,
    ChooseRun,
    first_process_timeout,
    no_agent_error,
    refuse_choice,
    running_swarm,
    runs_here,
    starting_text,
)
from crazychoir.runtime.clock import Clock, run_wall
from crazychoir.runtime.mailbox import Call
from crazychoir.team.graph import describe_ids

NOT_READY_TIMEOUT = 15.0
"""Seconds for which a command is repeated to a drone that is not ready yet."""
NOT_READY_RETRY_PERIOD = 0.3
"""Seconds between two of these repetitions."""
SILENT_ANSWER = "silent"
log = logging.getLogger(__name__)

if TYPE_CHECKING:
    from crazychoir.launch.flight_observer import FlightScore

Work = Callable[["Window"], Awaitable[Any]]
Answers = dict[int, tuple[bool, Any]]
"""For each drone: whether the request is done, and its answer or the reason for failure."""


class Window:
    """An observer's place in a running swarm.

    clock: clock of this process
    config: the swarm
    link: connection to its network
    option: the swarm file that was named, None without one
    patience: s within which the first process must be found
    """

    def __init__(
        self,
        clock: Clock,
        config: SwarmConfig,
        link: ZenohLink,
        option: str | None = None,
        patience: float = NEXT_PROCESS_TIMEOUT,
    ) -> None:
        self.clock = clock
        self.config = config
        self.link = link
        self.option = option
        self.patience = patience
        self.address, port = next(iter(link.bus.ports.items()))
        self.commander = Commander(port)

    @property
    def drones(self) -> list[int]:
        """Drones that were found, in order."""
        return sorted(
            j for j in self.link.directory if j < PORT_ADDRESSES.first_observer
        )

    def is_there(self, i: int) -> bool:
        """Return whether an agent of drone i was found."""
        return i in self.link.directory

    @property
    def replays(self) -> bool:
        """Whether the swarm is the replay of a recording."""
        return any(peer.host == REPLAY_HOST for peer in self.link.peers.values())

    async def find(self) -> list[int]:
        """Wait until all drones are found, at most NEXT_PROCESS_TIMEOUT s after the last one.

        Returns the drones that were found. Raises Refused if there is none.
        """
        await self.wait_for_drone()
        seen = 0
        ends = 0.0
        while len(self.drones) < len(self.config.ids):
            if len(self.drones) > seen:
                seen = len(self.drones)
                ends = self.clock.now() + NEXT_PROCESS_TIMEOUT
            if self.clock.now() >= ends:
                break
            await self.clock.sleep(SWARM_SEARCH.check_period)
        return self.drones

    async def wait_for_drone(self) -> None:
        """Wait until the first drone is found.

        Raises Refused if none is found in time, or soon after the run of the swarm has ended.
        """
        began = self.clock.now()
        looked = self.clock.now()
        said = False
        while not self.drones:
            now = self.clock.now()
            ended = (
                self.patience == SWARM_SEARCH.start_timeout
                and now - looked > NEXT_PROCESS_TIMEOUT
                and not runs_here(self.config)
            )
            looked = now if now - looked > NEXT_PROCESS_TIMEOUT else looked
            if ended or now - began >= self.patience:
                raise no_agent_error(self.config, self.option)
            if (
                now - began > SWARM_SEARCH.notice_delay
                and not said
                and self.patience > NEXT_PROCESS_TIMEOUT
            ):
                log.warning("%s", starting_text(self.config, self.patience))
                said = True
            await self.clock.sleep(SWARM_SEARCH.check_period)

    def check(self, option: str, ids: Iterable[int]) -> None:
        """Raise ConfigError for a drone that the swarm does not have."""
        for i in ids:
            if i not in self.config.ids:
                raise ConfigError(option, f"drone {i}", describe_ids(self.config.ids))

    def read(
        self,
        topic: Topic,
        i: int,
        function: Callable[[Any, float], None],
        rate: float = 0.0,
    ) -> Call[Any]:
        """Call the function with each value of drone i and its age in s.

        rate: Hz: largest number of calls a second, 0 for every value
        """
        box = Call(self.clock, function)
        self.link.bus.subscribe(
            topic, self.config.topology.source(topic, i), self.address, box, rate
        )
        return box

    def score(self) -> "FlightScore":
        """Return a score that follows the whole swarm from now on."""
        from crazychoir.launch.flight_observer import (
            FlightScore,
        )  # takes 1 s, for which a command should not wait

        return FlightScore(
            self.link.bus,
            self.config.ids,
            address=self.address,
            source=self.config.topology.source,
        )

    async def request(
        self, verb: str, drones: Iterable[int] | None = None, **arguments: Any
    ) -> Answers:
        """Send a request to these drones and return their answers; None means all drones."""
        return await self._ask(lambda i: self._request(i, verb, arguments), drones)

    async def order(
        self,
        verb: str,
        drones: Iterable[int] | None,
        seconds: float,
        **arguments: Any,
    ) -> Answers:
        """Send a flight command to these drones; None means all.

        A drone that is not ready yet is asked again, for at most NOT_READY_TIMEOUT s. A command that takes more
        than `seconds` is left as ACCEPTED.
        Returns for each drone whether it is done, and the kind of its answer with a text, such as
        "refused" and the reason.
        """
        return await self._ask(
            lambda i: self.order_one(i, verb, seconds, arguments), drones
        )

    async def command(
        self, verb: str, told: Mapping[int, Mapping[str, Any]], seconds: float
    ) -> Answers:
        """Send a flight command as `order` does, with arguments for each drone."""
        return await self._ask(
            lambda i: self.order_one(i, verb, seconds, told[i]), told
        )

    async def order_one(
        self,
        i: int,
        verb: str,
        seconds: float,
        arguments: Mapping[str, Any],
        on_accepted: Callable[[], None] = lambda: None,
    ) -> tuple[bool, Any]:
        """Send a flight command to one drone, as `order` does, and return its answer.

        on_accepted: called when the drone has accepted
        """
        began = self.clock.now()
        asks = self.clock.now() + min(seconds, NOT_READY_TIMEOUT)
        while True:
            try:
                answer = await self.commander.request(
                    i,
                    verb,
                    began + seconds - self.clock.now(),
                    on_accepted,
                    **arguments,
                )
            except TimeoutError:
                return False, (
                    SILENT_ANSWER,
                    f"no answer within {seconds:g} s; is its agent running?",
                )
            # The detail of this answer names only the time left at the last request, which is
            # not the time that the caller has waited. So we write our own text.
            if answer.kind == ANSWER_TEXTS.accepted:
                return False, (ANSWER_TEXTS.accepted, f"not done within {seconds:g} s")
            waits = answer.kind == ANSWER_TEXTS.refused and str(
                answer.detail
            ).startswith(ANSWER_TEXTS.not_ready)
            if not waits or self.clock.now() + NOT_READY_RETRY_PERIOD >= asks:
                return answer.kind == ANSWER_TEXTS.done, (
                    answer.kind,
                    str(answer.detail or ""),
                )
            await self.clock.sleep(NOT_READY_RETRY_PERIOD)

    async def emergency_stop(
        self, clear: bool, drones: Iterable[int] | None = None
    ) -> Answers:
        """Stop these drones, or clear their stop; None means the whole swarm.

        The bodies that the owner of a world or of radios holds are stopped too. So a drone falls
        even if its agent is gone or hangs. The answer then says that the agent has not obeyed but
        the body has.
        A stop of some drones concerns only those. A stop of the swarm keeps all drones on the
        ground until it is cleared.
        Raises Refused if there is no agent and no body, or if the keys here are not an operator's.
        """
        self.require_operator()
        meant = tuple(self.config.ids if drones is None else drones)
        return await EmergencyStop(
            self, meant, clear, alone=drones is not None and not clear
        ).run()

    def require_operator(self) -> None:
        """Raise Refused unless the keys here are an operator's.

        Drones and bodies obey operators only.
        """
        host = self.link.bus.host
        operators = self.config.security.operators
        if self.config.secured and host not in operators:
            alone = f"drones obey and answer only {', '.join(operators)} (security.operators of the swarm file)"
            text = f"the keys here, in {self.config.security.keys}, are those of {host}: {alone}. Command from there."
            raise Refused(f"swarm {self.config.name}", text)

    async def _request(
        self, i: int, verb: str, arguments: Mapping[str, Any]
    ) -> tuple[bool, Any]:
        try:
            answer: Answer = await self.commander.request(i, verb, **arguments)
        except TimeoutError as error:
            return False, str(error)
        if answer.kind == ANSWER_TEXTS.accepted:
            return False, f"accepted, {answer.detail}"
        if answer.kind == ANSWER_TEXTS.refused:
            return False, f"refused: {answer.detail}"
        return True, "acknowledged" if answer.detail is None else answer.detail

    async def _ask(
        self,
        ask: Callable[[int], Awaitable[tuple[bool, Any]]],
        drones: Iterable[int] | None = None,
    ) -> Answers:
        """Ask all drones at once, each as soon as it is found: an absent drone delays no other.

        ask: sends the request to one drone, and returns whether it was obeyed, and its answer
        drones: ids of the drones; None for all
        """
        self.require_operator()
        await self.wait_for_drone()
        asked = {
            i: asyncio.ensure_future(ask(i))
            for i in (self.config.ids if drones is None else drones)
        }
        try:
            there = await self.find()
            await asyncio.gather(*(asked[i] for i in there if i in asked))
            return {
                i: task.result() if task.done() else (False, ABSENT_ANSWER)
                for i, task in asked.items()
            }
        finally:
            for task in asked.values():
                task.cancel()


def observe_swarm(
    swarm: str | None,
    work: Work,
    choose: ChooseRun = refuse_choice,
    begin: Callable[[SwarmConfig], None] = lambda config: None,
) -> Any:
    """Join a running swarm as an observer, do the work, leave, and return the result of the work.

    swarm: path of the swarm file; None as in `running_swarm`
    work: coroutine function that gets the `Window` on the swarm
    choose: as in `running_swarm`
    begin: called with the swarm before it is joined
    """

    async def main(clock: Clock) -> Any:
        config = running_swarm(swarm, choose)
        begin(config)
        link = make_observer_link(clock, config)
        async with run_attached(link):
            return await work(
                Window(clock, config, link, swarm, first_process_timeout(config))
            )

    return run_wall(main)
