"""Virtual Crazyflies over UDP on the wall clock: one port a drone, one world, and cameras."""

import json
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.bus.json_view import to_plain_values
from crazychoir.errors import CodecError, ConfigError
from crazychoir.numerics.math3d import yaw_of
from crazychoir.radio.virtual.air import Air, VirtualDongle
from crazychoir.radio.virtual.cameras import CameraPort, observe_bodies
from crazychoir.radio.virtual.drone import DroneIdentity, VirtualCrazyflie
from crazychoir.radio.virtual.faults import Faults, check_faults
from crazychoir.radio.virtual.port import Address, DronePort
from crazychoir.radio.virtual.setup import DroneSeat
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.simulation.motor_level.battery import OPEN_CIRCUIT_CURVE
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class ServerLimits:
    """Limits of one pass, one answer and one error of the server."""

    steps_per_pass: int = 10
    """Steps of the world that a late server makes up for in one pass."""
    most_late_steps: int = 50
    """Steps of delay beyond which the server skips them."""
    answer_size: int = 48_000
    """Most bytes of the rows of drones in one answer. With the rest of the answer they fit into a
    datagram.
    """
    error_size: int = 40
    """Most characters of wrong words, and most drones, in an error."""


SERVER_LIMITS = ServerLimits()


@dataclass(frozen=True, slots=True)
class DeckModel:
    """How the decks on board measure."""

    period: int = 2
    """Steps of the world between two poses from a deck on board."""
    position_noise: float = 0.001
    """m: standard deviation, for each axis, of a position from a deck."""
    velocity_noise: float = 0.02
    """m/s: standard deviation, for each axis, of a velocity from a flow deck."""


DECK_MODEL = DeckModel()


@dataclass(frozen=True, slots=True)
class FaultEffects:
    """How faults act on a body and its battery."""

    least_charge: float = 1e-3
    """Least charge of a battery, from 0 to 1."""
    tumble_rate: float = 15.0
    """rad/s: roll rate of a body that tumbles; cameras can follow it."""
    upside_down_cosine: float = -0.9
    """Cosine of the tilt of a body that lies on its back."""


FAULT_EFFECTS = FaultEffects()


class VirtualServer(Actor):
    """Steps a world and serves its drones.

    seats: address and properties of each drone
    poses: address of the cameras and of questions
    dongles: groups of drones that share a radio
    seed: seed of losses and of the noise of decks
    """

    name = "virtual"

    def __init__(
        self,
        clock: Clock,
        world: CrazyflieWorld,
        seats: Sequence[DroneSeat],
        poses: Address,
        dongles: Sequence[VirtualDongle] = (),
        seed: int = 0,
    ) -> None:
        self.clock = clock
        self.world = world
        self.seats = tuple(seats)
        self.behind = 0
        """Steps of the world that were skipped because the machine was too slow."""
        self.busy_ns = 0
        """ns spent in steps."""
        self.dongles = tuple(dongles)
        shared = {i: dongle for dongle in self.dongles for i in dongle.drones}
        self.faults = {seat.id: Faults() for seat in self.seats}
        self.ports = {
            seat.id: DronePort(
                self._drone(seat),
                Air(clock, seat.id, self.faults[seat.id], shared.get(seat.id), seed),
                seat.at,
            )
            for seat in self.seats
        }
        self.cameras = CameraPort(clock, poses, self.answer)
        self._names = {seat.id: seat.body for seat in self.seats if seat.body}
        self._noise = random.Random(f"{seed} decks")  # noqa: S311 - a simulated sensor

    def _drone(self, seat: DroneSeat) -> VirtualCrazyflie:
        """Switch on the drone of a seat where it stands; it does not know its position yet."""
        row = self.world.row[seat.id]
        onboard = self.world.onboard[seat.id]
        onboard.place((0.0, 0.0, 0.0), 0.0)
        identity = DroneIdentity(
            f"virtual drone {seat.id}",
            seat.number,
            seat.release,
            seat.device,
            seat.decks,
        )
        return VirtualCrazyflie(
            onboard, identity, lambda: self.world.states[row, :3].tolist()
        )

    @property
    def drones(self) -> dict[int, VirtualCrazyflie]:
        """Drones by id."""
        return {i: port.drone for i, port in self.ports.items()}

    def listen(self) -> None:
        """Open the ports. Raises ConfigError if one is taken."""
        try:
            for port in self.ports.values():
                port.open()
            self.cameras.open()
        except ConfigError:
            self._close()
            raise

    async def run(self) -> None:
        """Step the world by the clock, and send what each drone has to send."""
        step_ns = round(self.world.dt * NS_PER_SECOND)
        due_ns = self.clock.now_ns() + step_ns
        async for _ in self.clock.ticks(1.0 / self.world.dt):
            began_ns = now_ns = self.clock.now_ns()
            for _ in range(SERVER_LIMITS.steps_per_pass):
                if due_ns > now_ns:
                    break
                self.step(due_ns / NS_PER_SECOND)
                due_ns += step_ns
            late = (self.clock.now_ns() - due_ns) // step_ns
            if late > SERVER_LIMITS.most_late_steps:
                self.behind = self.behind + late
                due_ns = due_ns + late * step_ns
            self.busy_ns += self.clock.now_ns() - began_ns

    def step(self, time: float) -> None:
        """Step the world once, then send what is due.

        time: s of the clock at the end of the step
        """
        self._hold()
        if self.world.tick % DECK_MODEL.period == 0:
            self._look_around()
        self.world.step()
        self._start_anew()
        for port in self.ports.values():
            port.look()
            for packet in port.drone.pass_time():
                port.say(packet)
        if self.cameras.watched:
            self.cameras.show(
                time,
                observe_bodies(
                    self.world.states, self.world.row, self.faults, self._names
                ),
            )

    def _hold(self) -> None:
        """Hold the batteries at their voltage and the bodies on their backs, as faults demand."""
        for i, fault in self.faults.items():
            if fault.tumble:
                overturn(self.world.states[self.world.row[i]])
            if fault.voltage > 0.0:
                self.world.charge_to(
                    i,
                    charge_at_voltage(
                        fault.voltage, self.world.platforms[self.world.row[i]].battery
                    ),
                )

    def _start_anew(self) -> None:
        """Reset the drones with a failed model.

        A drone without a finite state is put back at home first.
        """
        for i, why in self.world.failed.items():
            if not np.all(np.isfinite(self.world.states[self.world.row[i]])):
                self._carry_home(i)
            self.ports[i].drone.restart(why)

    def _look_around(self) -> None:
        """Give the estimators the measurements of decks.

        A lighthouse deck measures the position, a flow deck the velocity.
        """
        for i, port in self.ports.items():
            if self.faults[i].deck_lost:
                continue
            state = self.world.states[self.world.row[i]]
            onboard = port.drone.onboard
            if port.drone.flows:
                onboard.measured_velocity(
                    state[3:6] + self._error(DECK_MODEL.velocity_noise),
                    DECK_MODEL.velocity_noise,
                )
            if port.drone.positioned:
                onboard.external_pose(
                    state[:3] + self._error(DECK_MODEL.position_noise),
                    state[6:10].copy(),
                )

    def _error(self, std: float) -> Any:
        return np.array([self._noise.gauss(0.0, std) for _ in range(3)])

    # Questions

    def answer(self, question: Mapping[str, Any]) -> Any:
        """Answer a question at the cameras' port.

        The questions are:

            {"ask": "state"}
            {"ask": "faults"}
            {"faults": {"3,4": {"loss": 0.3}}}

        The first two are answered in parts: see `_part`.
        """
        if "faults" in question:
            self._set(question["faults"])
            return {"done": True}
        match question.get("ask"):
            case "state":
                return {"time": self.world.time, **self._part(question, self.state)}
            case "faults":
                return self._part(question, lambda i: self.faults[i].listed())
        allowed = '{"ask": "state"}, {"ask": "faults"}, {"faults": {id: {name: value}}}'
        raise CodecError(f"a question: {dict(question)}; allowed: {allowed}.")

    def _part(
        self, question: Mapping[str, Any], row_of: Callable[[int], Any]
    ) -> dict[str, Any]:
        """Return as many drones as a datagram holds, and whether more follow.

        The first is the drone after "after". The answer repeats "after", which distinguishes it
        from the answer to another question.

        row_of: returns the row of a drone
        """
        ids = list(self.ports)
        after = question.get("after")
        left = ids[ids.index(after) + 1 :] if after in ids else ids
        drones: dict[int, Any] = {}
        size = 0
        for i in left:
            row = row_of(i)
            size += len(json.dumps({i: to_plain_values(row)}))
            if drones and size > SERVER_LIMITS.answer_size:
                break
            drones[i] = row
        said = {} if after is None else {"after": after}
        return {
            "drones": drones,
            **said,
            **({"more": True} if len(drones) < len(left) else {}),
        }

    def _set(self, wanted: Any) -> None:
        """Set all faults, or none if one is not allowed."""
        if not isinstance(wanted, dict) or not all(
            isinstance(row, dict) for row in wanted.values()
        ):
            raise ConfigError("faults", wanted, "{id: {name: value}}")
        found = [
            (i, check_faults(row, tuple(self.ports)))
            for named, row in wanted.items()
            for i in self._list_named(named)
        ]
        for i, row in found:
            for name, value in row.items():
                self._put(i, name, value)

    def _list_named(self, drones: str) -> list[int]:
        """Return the drones of "all", "3" or "3,4"."""
        if drones == "all":
            return list(self.ports)
        names = {str(i): i for i in self.ports}
        words = [
            word.strip().lstrip("0") or "0"
            for word in drones.split(",")
            if word.strip()
        ]
        unknown = [word for word in words if word not in names]
        if unknown or not words:
            there = [*names][: SERVER_LIMITS.error_size]
            left = (
                [f"and {len(names) - SERVER_LIMITS.error_size} more"]
                if len(names) > SERVER_LIMITS.error_size
                else []
            )
            raise ConfigError(
                "faults: drone",
                ", ".join(unknown)[: SERVER_LIMITS.error_size],
                ", ".join(["all", *there, *left]),
            )
        return [names[word] for word in dict.fromkeys(words)]

    def _put(self, i: int, name: str, value: Any) -> None:
        drone = self.ports[i].drone
        fault = self.faults[i]
        if name == "reboot":
            if value:
                drone.restart()
        elif name == "home":
            if value:
                self._carry_home(i)
        elif name == "swap":
            self._swap(i, int(value))
        else:
            changed = getattr(fault, name) != value
            setattr(fault, name, value)
            if name == "refuse_arming":
                drone.refuse_arming(bool(value))
            elif name == "off" and changed:
                drone.restart()
        if name in ("motor", "off"):
            self.world.turn(
                i, [not fault.off and k + 1 != fault.motor for k in range(4)]
            )

    def _carry_home(self, i: int) -> None:
        self.world.restore(i)
        self._put(i, "motor", self.faults[i].motor)

    def _swap(self, i: int, j: int) -> None:
        """Exchange the poses of i and j, and undo any earlier exchange of either.

        j: the other drone; -1: only undo
        """
        for k in (i, j):
            if k in self.faults and (old := int(self.faults[k].swap)) >= 0:
                self.faults[k].swap = self.faults[old].swap = -1.0
        if j >= 0 and i != j:
            self.faults[i].swap = float(j)
            self.faults[j].swap = float(i)

    def state(self, i: int) -> dict[str, Any]:
        """Return the true state of a drone, and what it has received."""
        port = self.ports[i]
        row = self.world.row[i]
        world = self.world
        drone = port.drone
        x = self.world.states[self.world.row[i]]
        record = self.world.onboard[i].record
        up = 1.0 - 2.0 * (x[6] ** 2 + x[7] ** 2)
        return {
            "p": x[:3].tolist(),
            "v": x[3:6].tolist(),
            "q": x[6:10].tolist(),
            "yaw": float(yaw_of(x[6:10])),
            "estimate": [float(record[axis]) for axis in ("x", "y", "z")],
            "supervisor": "off" if self.faults[i].off else drone.onboard.state,
            "info": drone.flight.info,
            "motors": [float(share) for share in record["motors"]],
            "vbat": world.vbat(i),
            "zeros": drone.flight.zeros,
            "last": drone.flight.last,
            "poses": drone.flight.poses,
            "crashed": world.harm(i),
            "tumbled": bool(up < 0.5),
            "resting": world.resting(i),
            "client": None
            if port.client is None
            else f"{port.client[0]}:{port.client[1]}",
            "at": list(port.at),
            "up": port.air.up,
            "down": port.air.down,
            "lost": port.air.lost,
            "starts": drone.starts,
            "malformed": port.malformed + drone.flight.malformed,
            "unknown": drone.flight.unknown,
            "uptime": drone.uptime,
            "impact": float(world.impact[row]),
            "led": int(drone.parameters.read("led.bitmask")),
        }

    def report(self) -> dict[str, Any]:
        """Return the final state of each drone, and the load of the machine."""
        seconds = self.world.time
        return {
            "success": True,
            "seconds": seconds,
            "behind_s": self.behind * self.world.dt,
            "busy": self.busy_ns / NS_PER_SECOND / seconds if seconds > 0.0 else 0.0,
            "exchanges": [dongle.exchanges for dongle in self.dongles],
            "drones": {i: self.state(i) for i in self.ports},
        }

    async def on_stop(self) -> None:
        """Close the ports."""
        self._close()

    def _close(self) -> None:
        for port in self.ports.values():
            port.close()
        self.cameras.close()


def charge_at_voltage(volts: float, battery: Any) -> float:
    """Return the charge, 0 to 1 but not empty, at which a cell at rest has this voltage.

    volts: V
    battery: battery of the platform
    """
    x = (volts - battery.empty) / (battery.full - battery.empty)
    return max(
        float(
            np.interp(
                x, OPEN_CIRCUIT_CURVE, np.linspace(0.0, 1.0, len(OPEN_CIRCUIT_CURVE))
            )
        ),
        FAULT_EFFECTS.least_charge,
    )


def overturn(x: Vec) -> None:
    """Roll a body until it lies on its back, and hold it there.

    x: (13,) state, changed in place
    """
    upright = 1.0 - 2.0 * (x[6] ** 2 + x[7] ** 2) > FAULT_EFFECTS.upside_down_cosine
    x[10:13] = (FAULT_EFFECTS.tumble_rate if upright else 0.0, 0.0, 0.0)
