"""Drones of a running swarm that obey coroutines: one of them, or several at once."""

import asyncio
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from crazychoir.agent.command_arguments import path_message
from crazychoir.agent.order_times import LOAD_TIMEOUT, ORDER_TIMEOUTS
from crazychoir.api.running.receipts import OrderFailed, OrderReceipt
from crazychoir.api.running.state_log import StateLog
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.errors import ConfigError
from crazychoir.launch.observer import Window
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.trajectory_file import read_pieces
from crazychoir.runtime.mailbox import Latest
from crazychoir.types import Point, State, Status

ABSENT_TEXT = "its agent was not found"
"""Reason of a drone that is not there."""
REFUSAL_TIME = 0.2
"""s after its acceptance in which a drone may still refuse a command for which nothing waits."""
STATE_RATE = 20.0
"""Hz at which the states of all drones arrive."""
STATE_TIMEOUT = 2.0
"""s to wait for a state of a drone that is not stale."""
Told = Mapping[int, Mapping[str, Any]]
"""The arguments of a command, by drone."""


class DroneOrders:
    """Sends commands to drones, and raises OrderFailed for each drone that does not obey.

    window: place in the network of the swarm
    """

    def __init__(self, window: Window) -> None:
        self.window = window
        self._states: dict[int, Latest[State]] = {}
        self.statuses: dict[int, Status] = {}
        """The last status of each drone that has been heard."""
        self._ends: dict[int, str] = {}
        """Why the flight of each drone is over, if its result was the last that was heard."""
        self._open: set[asyncio.Task[Any]] = set()
        topic = DRONE_TOPICS.state
        for i in window.config.ids:
            states = self._states[i] = Latest(window.clock, "state", topic.max_age)
            window.read(topic, i, states.put, STATE_RATE)
            window.read(DRONE_TOPICS.status, i, partial(self._keep_status, i))
            window.read(DRONE_TOPICS.result, i, partial(self._keep_end, i))

    def _keep_status(self, i: int, status: Status, age: float) -> None:
        self.statuses[i] = status

    def _keep_end(self, i: int, result: Mapping[str, Any], age: float) -> None:
        why = str(result.get("reason") or "").removeprefix(f"drone {i}: ")
        self._ends[i] = why or "it has landed"

    def _explain_absence(self, i: int) -> str:
        """Return why no agent of drone i is there, as far as its result has been heard."""
        if i not in self._ends:
            return ABSENT_TEXT
        return f"its flight is over: {self._ends[i]}"

    def _receipt(self, i: int, verb: str, answer: str, reason: str) -> OrderReceipt:
        """Return what a drone has answered, with the last trouble that it has reported."""
        note = self.statuses[i].note if i in self.statuses else ""
        if not note or note in reason:
            return OrderReceipt(i, verb, answer, reason)
        return OrderReceipt(i, verb, answer, f"{reason}. It has reported: {note}")

    async def give(self, verb: str, told: Told, seconds: float, wait: bool) -> None:
        """Send a flight command.

        seconds: s within which it must be done
        wait: whether to return when it is done; else when all drones have accepted it
        """
        self.window.require_operator()
        tasks = {
            i: asyncio.ensure_future(self._give_one(i, verb, told[i], seconds, wait))
            for i in told
        }
        await asyncio.gather(*tasks.values())
        failed = [
            receipt for task in tasks.values() if (receipt := task.result()) is not None
        ]
        if failed:
            raise OrderFailed(failed)

    async def _give_one(
        self,
        i: int,
        verb: str,
        arguments: Mapping[str, Any],
        seconds: float,
        wait: bool,
    ) -> OrderReceipt | None:
        """Send a command to one drone; return its receipt, None if it obeys."""
        if not self.window.is_there(i):
            return self._receipt(i, verb, "absent", self._explain_absence(i))
        accepted = asyncio.Event()

        def accept() -> None:
            self._ends.pop(i, None)  # the result was one of an earlier agent
            accepted.set()

        task = asyncio.ensure_future(
            self.window.order_one(i, verb, seconds, arguments, accept)
        )
        if not wait:
            await self._wait_until_accepted(task, accepted)
            if not task.done():
                self._open.add(task)
                task.add_done_callback(self._open.discard)
                return None
        try:
            done, (answer, reason) = await task
        finally:
            task.cancel()
        if not done:
            return self._receipt(i, verb, answer, reason)
        accept()
        return None

    async def _wait_until_accepted(
        self, task: asyncio.Future[Any], accepted: asyncio.Event
    ) -> None:
        waiting = asyncio.ensure_future(accepted.wait())
        await asyncio.wait([task, waiting], return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        await asyncio.wait([task], timeout=REFUSAL_TIME)

    async def ask(self, verb: str, ids: Sequence[int], **arguments: Any) -> Any:
        """Send a request that moves nothing, and return the answer of each drone."""
        answers = await self.window.request(verb, ids, **arguments)
        failed = [
            _read_failure(i, verb, str(said))
            for i, (done, said) in answers.items()
            if not done
        ]
        if failed:
            raise OrderFailed(failed)
        return {i: said for i, (_, said) in answers.items()}

    async def wait_for_states(self, ids: Sequence[int]) -> dict[int, State]:
        """Return the newest state of each drone, with its present age.

        Raises OrderFailed for a drone if its newest state stays older than the topic allows.
        """
        clock = self.window.clock
        ends = clock.now() + STATE_TIMEOUT
        found = self._list_states(ids)
        while len(found) < len(ids) and clock.now() < ends:
            await clock.sleep(0.01)
            found = self._list_states(ids)
        missing = [i for i in ids if i not in found]
        if missing:
            why = f"no new state within {STATE_TIMEOUT:g} s"
            raise OrderFailed(self._receipt(i, "state", "silent", why) for i in missing)
        return found

    def _list_states(self, ids: Sequence[int]) -> dict[int, State]:
        """Return the newest state of each drone with its age; no state that is stale."""
        heard = {i: self._states[i].fresh_with_age() for i in ids}
        return {
            i: replace(state, age=age)
            for i, (state, age) in heard.items()
            if state is not None
        }


def _read_failure(i: int, verb: str, said: str) -> OrderReceipt:
    """Return the receipt for a text such as "refused: no such parameter"."""
    answer, _, reason = said.partition(": ")
    if answer not in ("refused", "absent"):
        answer, reason = "silent", said
    return OrderReceipt(i, verb, answer, reason)


class AsyncParameters:
    """The parameters of some drones, as `crazychoir param` reads and sets them."""

    def __init__(self, orders: DroneOrders, ids: Sequence[int]) -> None:
        self._orders = orders
        self._ids = ids

    async def get(self, name: str | None = None) -> dict[int, Any]:
        """Return a parameter of each drone, such as control.kp; all of them without a name."""
        asked = {} if name is None else {"name": name}
        found = await self._orders.ask("param_get", self._ids, **asked)
        if name is None:
            return dict(found)
        return {i: said[name] for i, said in found.items()}

    async def set(self, name: str, value: float | Sequence[float]) -> None:
        """Change a parameter, within its stable range, from the next tick on."""
        wanted = value if isinstance(value, int | float) else list(value)
        await self._orders.ask("param_set", self._ids, name=name, value=wanted)


class AsyncDrones:
    """Some drones of a running swarm.

    All flight commands raise OrderFailed, with a receipt for each drone that refuses, is silent or
    is not there. They return when the drones have done it. With `wait=False` they return when the
    drones have accepted it; a newer command then replaces it.

    orders: sends their commands
    ids: ids of the drones
    """

    def __init__(self, orders: DroneOrders, ids: Sequence[int]) -> None:
        self.ids = tuple(ids)
        """Ids of the drones."""
        self._orders = orders

    async def take_off(
        self, height: float | None = None, duration: float = 0.0, wait: bool = True
    ) -> None:
        """Take off and hover.

        height: m above the ground; None: the height that the mission wants
        duration: s, or 0: as fast as the limits allow
        """
        told = {"height": height, "duration": duration}
        await self._give("take-off", told, duration, wait)

    async def go_to(
        self,
        p: Point,
        yaw: float | None = None,
        duration: float = 0.0,
        relative: bool = False,
        speed: float | None = None,
        wait: bool = True,
    ) -> None:
        """Fly to a place.

        p: (3,) m, world
        yaw: rad; None: keep the present yaw
        duration: s, or 0: as fast as the limits allow
        relative: whether p and yaw count from the present set-point of each drone
        speed: m/s at most, on the way
        Raises ConfigError for several drones at one place.
        """
        if not relative and len(self.ids) > 1:
            raise ConfigError(
                "go_to: p",
                list(p),
                "one place for one drone",
                "Use swarm[i].go_to(...), or relative=True.",
            )
        told = {
            "p": [float(x) for x in p],
            "yaw": yaw,
            "duration": duration,
            "relative": relative,
            "speed": speed,
        }
        await self._give("go-to", told, duration, wait)

    async def velocity(
        self,
        v: Point,
        yaw_rate: float = 0.0,
        duration: float = 1.0,
        wait: bool = True,
    ) -> None:
        """Fly with a velocity for some time, then stop.

        v: (3,) m/s, world
        yaw_rate: rad/s
        duration: s, at most 10; a script renews the command for a longer flight
        """
        told = {"v": [float(x) for x in v], "yaw_rate": yaw_rate, "duration": duration}
        await self._give("velocity", told, duration, wait)

    async def follow(
        self,
        trajectory: Piecewise | str | Path,
        timescale: float = 1.0,
        reverse: bool = False,
        relative: bool = True,
        on_board: bool = False,
        wait: bool = True,
    ) -> None:
        """Fly along a trajectory, from its start to its end.

        trajectory: pieces of polynomials, or their CSV file in the form of Crazyswarm
        timescale: factor on its duration; 2 is half the speed
        reverse: whether to fly from its end to its start
        relative: whether it starts at the present set-point of each drone; else at its own places
        on_board: whether each drone flies it from its own memory, where it has a firmware;
            they begin when all have it
        """
        path = (
            trajectory if isinstance(trajectory, Piecewise) else read_pieces(trajectory)
        )
        told = path_message(
            path,
            timescale=timescale,
            reverse=reverse,
            relative=relative,
            on_board={} if on_board else None,
        )
        if on_board:
            everyone = dict.fromkeys(self.ids, told)
            await self._orders.give("load", everyone, LOAD_TIMEOUT, wait=True)
        await self._give("fly", told, timescale * path.duration, wait)

    async def hold(self) -> None:
        """Stop in the air; a mission waits, at most 300 s."""
        await self._give("hold", {}, 0.0, wait=True)

    async def land(
        self, height: float = 0.0, duration: float = 0.0, wait: bool = True
    ) -> None:
        """Land, and end the mission.

        height: m above the ground: height of the floor, such as a table, on which they land
        duration: s of the way down, or 0: as fast as the limits allow
        """
        told = {"height": height, "duration": duration}
        await self._give("land", told, duration, wait)

    async def order(self, verb: str, wait: bool = True) -> None:
        """Send another command without arguments: arm, start, go or home."""
        await self._give(verb, {}, 0.0, wait)

    async def stop(self) -> None:
        """Stop the motors at once (emergency stop); the drones fall."""
        window = self._orders.window
        answers = await window.emergency_stop(False, self._stopped)
        failed = [
            OrderReceipt(i, "stop", "silent", str(said))
            for i, (done, said) in answers.items()
            if not done
        ]
        if failed:
            raise OrderFailed(failed)

    @property
    def _stopped(self) -> Sequence[int] | None:
        """The drones that a stop names; None for the whole swarm."""
        return self.ids

    async def states(self) -> dict[int, State]:
        """Return the newest state of each drone: p, v, q, w, and its present age in s.

        Raises OrderFailed for a drone without a new state in the last 0.25 s, nor in the next 2 s.
        """
        return await self._orders.wait_for_states(self.ids)

    @property
    def param(self) -> AsyncParameters:
        """Their parameters."""
        return AsyncParameters(self._orders, self.ids)

    async def _give(
        self, verb: str, told: Mapping[str, Any], duration: float, wait: bool
    ) -> None:
        seconds = ORDER_TIMEOUTS[verb] + duration
        await self._orders.give(verb, dict.fromkeys(self.ids, told), seconds, wait)


class AsyncDrone(AsyncDrones):
    """One drone of a running swarm."""

    @property
    def id(self) -> int:
        """Its id."""
        return self.ids[0]

    async def state(self) -> State:
        """Return its newest state, as `states` does."""
        return (await self.states())[self.id]

    async def log(self, rate: float = 10.0) -> StateLog:
        """Collect its states from now on.

        rate: Hz at most
        """
        window = self._orders.window
        log = StateLog(window.clock)
        window.read(DRONE_TOPICS.state, self.id, log.add, rate)
        return log
