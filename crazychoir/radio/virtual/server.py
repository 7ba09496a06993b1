"""Virtual Crazyflies over UDP on the wall clock: one port a drone, one world, and cameras."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.radio.virtual.air import Air, VirtualDongle
from crazychoir.radio.virtual.cameras import CameraPort, observe_bodies
from crazychoir.radio.virtual.deck_sensors import DECK_MODEL, DeckSensors
from crazychoir.radio.virtual.drone import DroneIdentity, VirtualCrazyflie
from crazychoir.radio.virtual.fault_control import FaultControl
from crazychoir.radio.virtual.faults import Faults
from crazychoir.radio.virtual.port import Address, DronePort
from crazychoir.radio.virtual.questions import ServerQuestions
from crazychoir.radio.virtual.setup import DroneSeat
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld


@dataclass(frozen=True, slots=True)
class ServerLimits:
    """Limits of one pass of the server."""

    steps_per_pass: int = 10
    """Steps of the world that a late server makes up for in one pass."""
    most_late_steps: int = 50
    """Steps of delay beyond which the server skips them."""


SERVER_LIMITS = ServerLimits()


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
        self._control = FaultControl(world, self.ports, self.faults)
        self._decks = DeckSensors(world, self.ports, self.faults, seed)
        self.questions = ServerQuestions(world, self.ports, self.faults, self._control)
        self.cameras = CameraPort(clock, poses, self.questions.answer)
        self._names = {seat.id: seat.body for seat in self.seats if seat.body}
        self._mountings = {seat.id: seat.mounting for seat in self.seats}

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
        self._control.hold()
        if self.world.tick % DECK_MODEL.period == 0:
            self._decks.measure()
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
                    self.world.states,
                    self.world.row,
                    self.faults,
                    self._names,
                    self._mountings,
                ),
            )

    def _start_anew(self) -> None:
        """Reset the drones with a failed model.

        A drone without a finite state is put back at home first.
        """
        for i, why in self.world.failed.items():
            if not np.all(np.isfinite(self.world.states[self.world.row[i]])):
                self._control.carry_home(i)
            self.ports[i].drone.restart(why)

    def report(self) -> dict[str, Any]:
        """Return the final state of each drone, and the load of the machine."""
        seconds = self.world.time
        return {
            "success": True,
            "seconds": seconds,
            "behind_s": self.behind * self.world.dt,
            "busy": self.busy_ns / NS_PER_SECOND / seconds if seconds > 0.0 else 0.0,
            "exchanges": [dongle.exchanges for dongle in self.dongles],
            "drones": {i: self.questions.describe_drone(i) for i in self.ports},
        }

    async def on_stop(self) -> None:
        """Close the ports."""
        self._close()

    def _close(self) -> None:
        for port in self.ports.values():
            port.close()
        self.cameras.close()
