"""Flights of many virtual drones on one virtual dongle, in virtual time: the owner's drones without cflib's links."""

import math
from functools import partial
from pathlib import Path

import numpy as np

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.config.dongle_plan import capacity_of
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.radio.budget import plan_dongles
from crazychoir.radio.drone.own_estimate import LOG_NAMES
from crazychoir.radio.drone.pose_broadcast import PoseBroadcast
from crazychoir.radio.drone.radio_drone import RadioDrone, SharedRadio
from crazychoir.radio.link.pending_requests import PendingRequests
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.protocol.compressed import pack_quaternion
from crazychoir.radio.virtual.air import Air, VirtualDongle
from crazychoir.radio.virtual.drone import DroneIdentity, VirtualCrazyflie
from crazychoir.radio.virtual.faults import Faults
from crazychoir.radio.virtual.setup import select_from_swarm
from crazychoir.types import XYZ, Pose


class AirLink:
    """The connection to a virtual drone through a virtual dongle; what waits at the dongle may still be replaced.

    air: loses packets;  heard: called with each answer of the drone
    """

    def __init__(self, clock, dongle, air, crazyflie, heard):
        self.clock, self.dongle, self.air, self.crazyflie = (
            clock,
            dongle,
            air,
            crazyflie,
        )
        self.uri, self.latency, self.answered, self.rssi = "air", 0.01, 1.0, math.nan
        self.hears_broadcasts = True
        self.requests = PendingRequests(self.send, heard)
        self.ask = self.requests.ask
        self._newest, self._heard_at = {}, clock.now()

    @property
    def silence(self):
        return self.clock.now() - self._heard_at

    def send(self, packet):
        self._up(lambda: packet)

    def _up(self, choose):
        """Queue a packet that is chosen when it leaves; None: none leaves."""

        def leave():
            packet = choose()
            if packet is not None:
                self.air.rise(partial(self._arrive, packet))

        self.dongle.up(self.air.drone, leave)

    def urgent(self, packets):
        for packet in packets:
            self.send(packet)

    def newest(self, kind, packet):
        waits = kind in self._newest
        self._newest[kind] = packet
        if not waits:
            self._up(lambda: self._newest.pop(kind))

    def forget(self, kind):
        if kind in self._newest:
            self._newest[kind] = None

    def send_at_once(self, packets):
        for packet in packets if self.hears_broadcasts else ():
            self.dongle.spread(
                packet.framed(),
                partial(self.air.rise, partial(self._arrive, packet)),
            )

    def _arrive(self, packet):
        for answer in self.crazyflie.take(packet):
            self.say(partial(self.requests.take, answer))

    def say(self, deliver):
        def come():
            self._heard_at = self.clock.now()
            deliver()

        self.dongle.down(self.air.drone, partial(self.air.sink, come))


class DongleFlight:
    """Drones of one dongle, their owner's side and their bodies.

    config: all drones at dongle 0, of the sender xyz;  loss: of packets, each way
    farthest: from home so far, along each axis, m.
    slowness: s of the clock in which the world of a loaded machine moves on by 1 s.
    """

    def __init__(self, clock, config, loss=0.0):
        self.clock, self.config = clock, config
        self.slowness = 1.0
        self.plan = plan_dongles(config)[0]
        self.hall = select_from_swarm(config, None)
        self.world = self.hall.world(0)
        self.dongle = VirtualDongle(clock, config.ids, capacity_of(config, 0))
        self.broadcast = (
            PoseBroadcast(clock, config.radio.pose_rate)
            if self.plan.broadcasts
            else None
        )
        bus = Bus(clock)
        shared = SharedRadio(TableOfContents(Path("nowhere")), broadcast=self.broadcast)
        self.drones, self.crazyflies, self.links = {}, {}, {}
        self.farthest = {i: np.zeros(3) for i in config.ids}
        for seat in self.hall.seats:
            i = seat.id
            bus.port(PORT_ADDRESSES.body_offset + i)
            onboard = self.world.onboard[i]
            onboard.place(tuple(config.drone(i).home), 0.0)
            drone = RadioDrone(bus, config, i, "xyz", self.plan.setpoint_rate, shared)
            crazyflie = VirtualCrazyflie(onboard, DroneIdentity(number=seat.number))
            air = Air(clock, i, Faults(loss=loss))
            link = AirLink(clock, self.dongle, air, crazyflie, drone.landing.hear)
            drone.link.connection = link
            drone.preparation.is_prepared = drone.preparation.is_placed = True
            self.drones[i], self.crazyflies[i], self.links[i] = drone, crazyflie, link

    def truth(self, i):
        return self.world.states[self.world.row[i]]

    async def run(self, seconds, command=lambda i, t: None):
        """Step the bodies; let the cameras see them 50 times a second, and the drones report 20 times.

        command: called ten times a second with each drone's id and the s since the start; returns its command or None
        """
        dt = self.world.dt
        every = {
            name: round(1.0 / rate / dt)
            for name, rate in (("see", 50), ("log", 20), ("fly", 10))
        }
        for k in range(round(seconds / dt)):
            await self.clock.sleep(self.slowness * dt)
            self.world.step()
            for i, drone in self.drones.items():
                for _ in self.crazyflies[i].pass_time():
                    pass
                x = self.truth(i)
                place = x[:3] - self.config.drone(i).home
                self.farthest[i] = np.maximum(self.farthest[i], np.abs(place))
                if k % every["see"] == 0:
                    drone.view.see(Pose(np.array([*x[:3], *x[6:10]])), 0.0)
                if (k + i) % every["log"] == 0:
                    self._log(i)
                if (k + 3 * i) % every["fly"] == 0:
                    drone.landing.go_on()
                    if (sent := command(i, k * dt)) is not None:
                        drone.commands.send(sent)

    async def take_off(self, height):
        """Let all drones rise, and hover."""
        await self.run(0.5)
        rise = XYZ("take_off", np.array([0.0, 0.0, height, 0.0, 1.5]))
        await self.run(
            3.0, lambda i, t: None if self.drones[i].estimate.is_flying else rise
        )

    async def land(self, seconds=4.6):
        """Let all drones land where they are above."""

        def command(i, t):
            x, y, _ = self.config.drone(i).home
            return XYZ("land", np.array([x, y, -0.25, 0.0, 3.0]))

        await self.run(seconds, command)

    def unwell(self):
        """Return the drones that do not stand whole at their homes."""
        return {
            i: (self.truth(i)[:3].round(3), self.world.harm(i), self.world.resting(i))
            for i in self.drones
            if self.world.harm(i)
            or not self.world.resting(i)
            or math.dist(self.truth(i)[:3], self.config.drone(i).home) > 0.1
        }

    def _log(self, i):
        crazyflie = self.crazyflies[i]
        values = {
            name: crazyflie.read_log(name)
            for name in (*LOG_NAMES.estimate[:6], *LOG_NAMES.health)
        }
        q = self.truth(i)[6:10]
        values[LOG_NAMES.estimate[6]] = pack_quaternion(q)
        at = crazyflie.uptime
        self.links[i].say(lambda: self.drones[i].estimate.take_log(values, at))


def crowd(n, inline=True, **radio):
    """A swarm of n drones at one dongle, 0.7 m apart."""
    rows = [
        {
            "id": i,
            "home": [0.7 * (i % 4), 0.7 * (i // 4), 0.0],
            "uri": f"udp://127.0.0.1:{19850 + i}",
            "platform": "cf21",
        }
        for i in range(n)
    ]
    return SwarmConfig.of(
        {
            "name": "crowd",
            "drones": rows,
            "control": {"sender": "xyz"},
            "radio": {"inline": inline} | radio,
        }
    )
