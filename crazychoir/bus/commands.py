"""Commands with answers: (id, issuer, target, deadline, body) -> ACCEPTED, REFUSED (reason), DONE.

A request is resent until it is answered, executed once for each id, and refused after its deadline.
The emergency stop has its own class: it is resent until every drone has acknowledged, and stays in
force until an operator clears it.
"""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from crazychoir.bus.codec import encode
from crazychoir.bus.message import Message
from crazychoir.bus.port import Port
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import CodecError, ConfigError, Refused, error_text


@dataclass(frozen=True, slots=True)
class RequestRules:
    """How often a request is repeated, and how many answers a server remembers."""

    resend_interval: float = 0.1
    """s between repeats of a request without an answer."""
    accepted_interval: float = 0.5
    """s between repeats of an accepted request."""
    remembered_answers: int = 256
    """Answers, and issuers of commands, that a server remembers."""


REQUEST_RULES = RequestRules()


STOP_ALONE = "alone"
"""Content of a stop for its targets only: it does not keep other drones on the ground."""
COMMANDED_PREFIX = "commanded: "
"""Prefix of the log line of a drone that executes an operator's command."""


@dataclass(frozen=True, slots=True)
class AnswerTexts:
    """The kinds of answers to a command, and the prefix of a temporary refusal."""

    accepted: str = "accepted"
    """The drone has the command and executes it."""
    refused: str = "refused"
    """The drone does not execute the command; the detail is the reason."""
    done: str = "done"
    """The drone has executed the command."""
    not_ready: str = "it is not ready"
    """Prefix of a temporary refusal; the command may be retried."""


ANSWER_TEXTS = AnswerTexts()


_ACCEPTED_ANSWER = encode([ANSWER_TEXTS.accepted, None])
_OUTDATED_ANSWER = encode(
    [ANSWER_TEXTS.refused, "it is older than what was asked since"]
)
_Key = tuple[int, str, int]
"""Key of a request: its issuer, the issuer's incarnation, its number."""

Execute = Callable[[str, dict[str, Any]], Awaitable[Any]]
"""Callable that gets (verb, arguments) and returns the content of DONE.

It raises Refused, or any other error, to refuse.
"""


@dataclass(frozen=True)
class Answer:
    """The end of a request."""

    target: int
    """Drone that was asked."""
    kind: str
    """DONE or REFUSED; ACCEPTED if the command was not done by the deadline."""
    detail: Any
    """Result, or reason."""


class Commander:
    """The issuing side: sends commands to drones and waits for their answers."""

    def __init__(self, port: Port) -> None:
        self.port = port
        self._count = 0
        self._waiting: dict[
            int, tuple[int, asyncio.Future[Answer]]
        ] = {}  # {number: (target, answer)}
        self._accepted: dict[int, None] = {}
        self._on_accepted: dict[int, Callable[[], None]] = {}
        self._acknowledged: dict[int, dict[int, None]] = {}
        port.handlers[MESSAGE_TOPICS.answer.number] = self._answered

    async def request(
        self,
        target: int,
        verb: str,
        deadline: float = 5.0,
        on_accepted: Callable[[], None] = lambda: None,
        **arguments: Any,
    ) -> Answer:
        """Send a command to drone `target` and return its answer.

        deadline: seconds
        on_accepted: called once when the drone has accepted
        Raises TimeoutError if there is no answer within `deadline`.
        """
        self._count += 1
        number = self._count
        future: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        self._waiting[number] = target, future
        self._on_accepted[number] = on_accepted
        clock = self.port.bus.clock
        ends = clock.now() + deadline
        try:
            async with asyncio.timeout(deadline):
                attempt = 0
                while not future.done():
                    body = encode([verb, arguments, ends - clock.now()])
                    request = Message(
                        MESSAGE_TOPICS.request,
                        self.port.address,
                        body,
                        number,
                        f"{self.port.incarnation:x}",
                    )
                    self.port.send(request, (target,), attempt)
                    attempt += 1
                    await asyncio.wait(
                        [future],
                        timeout=REQUEST_RULES.accepted_interval
                        if number in self._accepted
                        else REQUEST_RULES.resend_interval,
                    )
                return future.result()
        except TimeoutError:
            if number in self._accepted:
                return Answer(
                    target, ANSWER_TEXTS.accepted, f"not done within {deadline:g} s"
                )
            text = f"drone {target}: no answer to {verb!r} within {deadline:g} s; is its agent running?"
            raise TimeoutError(text) from None
        finally:
            del self._waiting[number], self._on_accepted[number]
            self._accepted.pop(number, None)

    async def emergency_stop(
        self,
        targets: list[int],
        clear: bool = False,
        deadline: float = 10.0,
        alone: bool = False,
        answered: dict[int, None] | None = None,
    ) -> list[int]:
        """Stop all targets, or clear their stop, and return the targets that did not acknowledge.

        The stop is resent until each target acknowledges.
        targets: drones; those removed from the list meanwhile get no further message
        clear: True to clear the stop
        deadline: seconds; may be infinite
        alone: True for a stop of these drones only: their motors stop, and it need not be cleared
        answered: filled with the drones that have acknowledged
        """
        self._count += 1
        number = self._count
        answered = self._acknowledged[number] = {} if answered is None else answered
        clock = self.port.bus.clock
        ends = clock.now() + deadline
        try:
            while missing := [j for j in targets if j not in answered]:
                if clock.now() > ends:
                    break
                body = encode(STOP_ALONE if alone else clear)
                stop = Message(
                    MESSAGE_TOPICS.emergency_stop,
                    self.port.address,
                    body,
                    number,
                    f"{self.port.incarnation:x}",
                )
                self.port.send(stop, missing)
                await clock.sleep(REQUEST_RULES.resend_interval)
            return missing
        finally:
            del self._acknowledged[number]

    def _answered(self, message: Message, age: float) -> None:
        """Take an answer to a request, or the acknowledgement of a stop."""
        source = message.source
        number = message.number
        if message.channel != f"{self.port.incarnation:x}":
            return
        if number in self._acknowledged:
            self._acknowledged[number][source] = None
        target, future = self._waiting.get(number, (source, None))
        try:
            kind, detail = message.open()
        except (CodecError, TypeError, ValueError):
            self.port.counters.malformed += 1
            return
        if future is None or future.done() or source != target:
            # Only the target itself may answer.
            return
        if kind == ANSWER_TEXTS.accepted:
            if number not in self._accepted:
                self._accepted[number] = None
                self._on_accepted[number]()
        else:
            future.set_result(Answer(source, kind, detail))


class CommandServer:
    """Executes the commands that arrive at one drone, and answers them.

    A repeated request gets the stored answer of the first; it is not executed again. If that answer
    is no longer stored, the repetition is refused. Its low number shows that it is old: the numbers
    of an issuer increase until the issuer restarts.
    execute: executes a command
    on_stop: called with True for a stop, False for a clear
    """

    def __init__(
        self, port: Port, execute: Execute, on_stop: Callable[[bool], None]
    ) -> None:
        self.port = port
        self.execute = execute
        self.on_stop = on_stop
        self._answers: dict[_Key, bytes] = {}
        self._running: dict[_Key, asyncio.Task[None]] = {}
        # {(issuer, incarnation): highest number with a forgotten answer}
        self._forgotten: dict[tuple[int, str], int] = {}
        # {(issuer, incarnation, clear): number of the newest stop or clear}
        self._newest: dict[tuple[int, str, bool], int] = {}
        port.handlers[MESSAGE_TOPICS.request.number] = self._requested
        port.handlers[MESSAGE_TOPICS.emergency_stop.number] = self._stopped

    def _requested(self, message: Message, age: float) -> None:
        """Take a request: repeat its answer if it is known, else
        execute it if it is valid and in time.
        """
        source = message.source
        number = message.number
        channel = message.channel
        key = (source, channel, number)
        if key in self._answers:
            self._send(key, self._answers[key])
            return
        if key in self._running:
            self._send(key, _ACCEPTED_ANSWER)
            return
        if number <= self._forgotten.get((source, channel), -1):
            self._send(key, _OUTDATED_ANSWER)
            return
        try:
            verb, arguments, remaining = message.open()
            late = float(remaining) <= age
            known = isinstance(verb, str) and isinstance(arguments, dict)
        except (CodecError, TypeError, ValueError):
            known = late = False
        if not known:
            self.port.counters.malformed += 1
        elif late:
            self._answer(key, ANSWER_TEXTS.refused, "the deadline has passed")
        else:
            self._start(key, verb, arguments)

    def _start(self, key: _Key, verb: str, arguments: dict[str, Any]) -> None:
        name = f"drone {self.port.address} command {verb}"
        task = asyncio.get_running_loop().create_task(
            self._run(key, verb, arguments), name=name
        )
        self._running[key] = task
        task.add_done_callback(lambda task: self._running.pop(key))
        self._send(key, _ACCEPTED_ANSWER)

    async def _run(self, key: _Key, verb: str, arguments: dict[str, Any]) -> None:
        try:
            self._answer(key, ANSWER_TEXTS.done, await self.execute(verb, arguments))
        except Refused as refused:
            self._answer(key, ANSWER_TEXTS.refused, refused.reason)
        except ConfigError as error:
            self._answer(key, ANSWER_TEXTS.refused, str(error))
        except Exception as error:  # noqa: BLE001 - the issuer is told; the drone flies on
            self._answer(key, ANSWER_TEXTS.refused, error_text(error))

    def _answer(self, key: _Key, kind: str, detail: Any) -> None:
        payload = self._answers[key] = encode([kind, detail])
        while len(self._answers) > REQUEST_RULES.remembered_answers:
            self._forget(next(iter(self._answers)))
        self._send(key, payload)

    def _forget(self, key: _Key) -> None:
        del self._answers[key]
        source, channel, number = key
        forgotten = self._forgotten
        forgotten[source, channel] = max(number, forgotten.pop((source, channel), -1))
        while len(forgotten) > REQUEST_RULES.remembered_answers:
            del forgotten[next(iter(forgotten))]

    def _send(self, key: _Key, payload: bytes) -> None:
        source, channel, number = key
        answer = Message(
            MESSAGE_TOPICS.answer, self.port.address, payload, number, channel
        )
        self.port.send(answer, (source,))

    def _stopped(self, message: Message, age: float) -> None:
        """Handle a stop or a clear.

        A late or repeated message is acknowledged, but does not undo a later order. The numbers of
        one issuer increase: a clear does not count after a newer stop of the same issuer, nor a
        stop after a newer clear. A stop after a newer stop does count, because one may be for the
        swarm and the other for its targets only.
        """
        source = message.source
        number = message.number
        channel = message.channel
        key = (source, channel, number)
        try:
            said = message.open()
        except CodecError:
            said = None
        clear = said is True
        if key not in self._answers and number > self._newest.get(
            (source, channel, not clear), -1
        ):
            if said != STOP_ALONE:
                self.port.bus.stopped = not clear
            self.on_stop(not clear)
        self._note(source, channel, clear, number)
        self._answer(key, ANSWER_TEXTS.done, None)

    def _note(self, source: int, channel: str, clear: bool, number: int) -> None:
        newest = self._newest
        newest[source, channel, clear] = max(
            number, newest.pop((source, channel, clear), -1)
        )
        while len(newest) > REQUEST_RULES.remembered_answers:
            del newest[next(iter(newest))]
