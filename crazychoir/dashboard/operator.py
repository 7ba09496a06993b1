"""Execution of a page's requests: commands, planning of drawings, reading and writing of files."""

import asyncio
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, ParamSpec, TypeVar

import numpy as np

from crazychoir.agent.order_times import ORDER_TIMEOUTS
from crazychoir.agent.sketch import (
    PlannedSketch,
    flight_messages,
    flight_places,
    load_with_remarks,
    plan_sketch,
    plan_trajectory,
    strokes_as_text,
)
from crazychoir.config.network import impairment_changes, rules_in_words
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import LinkTable
from crazychoir.dashboard.commands import CommandDesk
from crazychoir.dashboard.firmware_parameters import FirmwareParameters
from crazychoir.dashboard.polling import TaskBoard
from crazychoir.dashboard.receipts import Receipt
from crazychoir.dashboard.requests import (
    AddTask,
    CancelTask,
    Draw,
    Fly,
    GoTo,
    Ids,
    Impair,
    ListParameters,
    Load,
    Message,
    Move,
    Order,
    PlanTrajectory,
    ReadParameters,
    Save,
    SetParameter,
    Steer,
    Stop,
    Strokes,
)
from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.drawing import Pen
from crazychoir.planning.trajectory_file import has_pieces, parse_pieces
from crazychoir.team.graph import describe_ids

P = ParamSpec("P")
T = TypeVar("T")
Work = Callable[[], Coroutine[Any, Any, dict[str, Any] | None]]
"""Work that takes a while; it returns the answer for the page."""
MOST_LINK_ENDS = 2
"""Largest number of drones that can select a link."""


class PageOperator:
    """The operator of one page."""

    def __init__(
        self, config: SwarmConfig, desk: CommandDesk, board: TaskBoard
    ) -> None:
        self.config = config
        self.desk = desk
        self.board = board
        self._parameters = FirmwareParameters(desk)
        self._plan: PlannedSketch | None = None
        self._drawn, self._planning = 0, asyncio.Lock()

    def asked(self, message: Message) -> Work | None:
        """Do what the message asks, or return the work if it takes a while.

        Raises ConfigError with the reason if it cannot be done.
        """
        match message:
            case Order() | Stop() | GoTo() | Move() | Steer():
                self.command(message)
            case Draw() | PlanTrajectory():
                self._plan = None
                self._drawn = self._drawn + 1
                return partial(self._draw, message, self._drawn)
            case Fly():
                self._fly(message)
            case Load(name, text):
                return partial(_answer_load_in_thread, name, text)
            case Save(strokes, kind):
                return partial(_answer_save_in_thread, strokes, kind)
            case Impair():
                self._impair(message)
            case AddTask(pickup, delivery, load):
                words = (
                    f"{list(pickup)} to {list(delivery)}"
                    if delivery
                    else f"{list(pickup)}"
                )
                self.board.begin(
                    "task_add", words, pickup=pickup, delivery=delivery, load=load
                )
            case ListParameters(drone):
                self._checked((drone,))
                return partial(self._parameters.list_names, drone)
            case ReadParameters(drone, name):
                self._checked((drone,))
                return partial(self._parameters.read, drone, name)
            case SetParameter(drone, name, value):
                self._checked((drone,))
                return partial(self._parameters.change, drone, name, value)
            case CancelTask(j):
                self.board.begin("task_cancel", str(j), id=j)
        return None

    def command(self, message: Order | Stop | GoTo | Move | Steer) -> Receipt:
        """Give a command that needs no preparation, and return its receipt.

        Raises ConfigError with the reason if it cannot be given.
        """
        match message:
            case Order(verb, drones):
                return self.desk.order(verb, self._those(drones))
            case Stop(drones, clear, key):
                return self.desk.stop(self._those(drones), clear, key)
            case Steer(drone, v, yaw_rate):
                return self.desk.steer(self._checked((drone,))[0], v, yaw_rate)
            case Move():
                return self._move(message)
        return self._go_to(message)

    def _impair(self, message: Impair) -> None:
        """Send the change to every drone.

        Each drone simulates the network for the messages it sends, and answers with what is then in
        force.
        """
        drones = self._those(message.drones)
        told: dict[str, Any] = {"clear": True} if message.clear else {}
        given = {
            name: value
            for name in ("loss", "delay")
            if (value := getattr(message, name)) is not None
        }
        words = [f"{name} {value:g}" for name, value in given.items()] + (
            ["clear"] if message.clear else []
        )
        if message.cut:
            if drones is None:
                raise ConfigError("cut off", "no drones", "the drones of one side")
            told["cut"] = {"since": 0.0, "a": list(drones)}
            words.append("cut off")
        elif drones is not None and len(drones) > MOST_LINK_ENDS:
            raise ConfigError(
                "drones",
                f"{len(drones)} of them",
                "none for all links, one for its links, two for one",
            )
        elif drones is not None:
            told |= {"drone": drones[0]} if len(drones) == 1 else {"edge": list(drones)}
        words.append(describe_ids(drones) if drones else "all links")
        self.desk.order(
            "impair",
            words=", ".join(words),
            each=lambda i: told | impairment_changes(LinkTable(**given)),
            says=lambda network: "; ".join(rules_in_words(network)),
        )

    def _go_to(self, message: GoTo) -> Receipt:
        drones = self._checked(message.drones)
        goals = flight_places(message.p, message.offset, drones, self.config)
        return self.desk.order(
            "go-to",
            goals,
            words=f"{list(message.p)} m",
            each=lambda i: {"p": goals[i], "yaw": message.yaw},
        )

    def _move(self, message: Move) -> Receipt:
        v = list(message.v)
        duration = message.duration
        return self.desk.order(
            "velocity",
            self._checked(message.drones),
            duration + ORDER_TIMEOUTS["velocity"],
            f"{v} m/s, {duration:g} s",
            each=lambda i: {"v": v, "yaw_rate": message.yaw_rate, "duration": duration},
        )

    async def _draw(
        self, message: Draw | PlanTrajectory, number: int
    ) -> dict[str, Any] | None:
        """Plan in a thread, one drawing at a time; only the newest drawing counts.

        Returns None for a drawing that was replaced by a newer one.
        """
        async with self._planning:
            if number != self._drawn:
                return None
            plan = await _run_in_thread(_plan, message, self.config)
        if number != self._drawn:
            return None
        self._plan = plan
        return {"plan": plan.shown()}

    def _fly(self, message: Fly) -> None:
        """Order the flight; paths are computed in a thread, so that a stop is not delayed."""
        plan = self._plan
        if plan is None:
            raise ConfigError(
                "fly",
                "nothing that was planned",
                "a drawing that was planned, and shown, before",
            )
        drones = self._checked(message.drones)
        told = asyncio.create_task(
            _run_in_thread(
                flight_messages, plan.path, drones, message.offset, self.config
            )
        )
        seconds = plan.path.duration + ORDER_TIMEOUTS["fly"]
        words = f"{plan.path.duration:.1f} s"
        self.desk.order(
            "fly", drones, seconds, words, each=lambda i: told.result()[i], first=told
        )

    def _those(self, drones: Ids | None) -> Ids | None:
        return None if drones is None else self._checked(drones)

    def _checked(self, drones: Ids) -> Ids:
        """Return these drones, each once.

        Raises ConfigError if the swarm does not have one of them.
        """
        for i in drones:
            if i not in self.config.ids:
                raise ConfigError("drones", i, describe_ids(self.config.ids))
        return tuple(dict.fromkeys(drones))


def _plan(message: Draw | PlanTrajectory, config: SwarmConfig) -> PlannedSketch:
    """Return the flight that the message describes. Raises ConfigError if it cannot be flown."""
    if isinstance(message, PlanTrajectory):
        path = parse_pieces(message.text, message.name)
        return plan_trajectory(
            path, config, message.name, message.slower, message.height
        )
    pen = Pen(
        height=message.height,
        lift=message.lift,
        yaw=message.yaw,
        timing=message.timing,
        smoothing=message.smoothing,
    )
    return plan_sketch(
        message.strokes, pen, config, message.v_max, message.a_max, message.slower
    )


def answer_load(text: str, name: str) -> dict[str, Any]:
    """Return the answer to Load: the strokes, and remarks on parts that cannot be flown.

    For a trajectory it is the file itself, which the page sends again to plan it.
    """
    if name.lower().endswith(".csv") and has_pieces(text):
        path = parse_pieces(text, name)
        start = round(float(path.sample(0.0).p[2]), 3)
        return {"trajectory": {"name": name, "text": text, "height": start}}
    strokes, words = load_with_remarks(text, name)
    return {"remarks": words, "strokes": strokes}


async def _answer_load_in_thread(name: str, text: str) -> dict[str, Any]:
    return await _run_in_thread(answer_load, text, name)


async def _answer_save_in_thread(strokes: Strokes, kind: str) -> dict[str, Any]:
    return {
        "saved": {
            "text": await _run_in_thread(
                strokes_as_text, [np.array(stroke) for stroke in strokes], kind
            ),
            "kind": kind,
        }
    }


async def _run_in_thread(
    work: Callable[P, T], *arguments: P.args, **named: P.kwargs
) -> T:
    """Run a long computation in a thread and return its result."""
    return await asyncio.to_thread(work, *arguments, **named)
