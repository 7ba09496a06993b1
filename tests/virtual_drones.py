"""A virtual Crazyflie without sockets, in virtual time: packets in, the world stepped, packets out."""

from dataclasses import replace

from msgspec import structs

from crazychoir.firmware.release import DESCRIBED_RELEASE
from crazychoir.radio.protocol.crtp import PACKET_FORMS
from crazychoir.radio.virtual.drone import (
    DroneIdentity,
    VirtualCrazyflie,
)
from crazychoir.radio.virtual.setup import place_on_grid


class Hangar:
    """One perfect drone with its world.

    told: whether it is told each 20 ms where it is;  said: packets that it has sent.
    """

    def __init__(self, platform="cf21", yaw=0.0, height=0.0, told=True, **identity):
        hall = place_on_grid(1, 19850, ())
        config = hall.config.replace(motors={"imperfections": 0.0})
        (row,) = hall.drones
        row = structs.replace(row, platform=platform, yaw=yaw, home=(0.0, 0.0, height))
        self.world = replace(hall, drones=(row,), config=config).world(
            0, identity.get("release", DESCRIBED_RELEASE)
        )
        self.onboard = self.world.onboard[0]
        self.drone = VirtualCrazyflie(
            self.onboard,
            DroneIdentity(**identity),
            lambda: self.world.states[0, :3].tolist(),
        )
        self.told, self.said = told, []

    def send(self, name, *values):
        """One packet; its answers."""
        return list(self.drone.take(PACKET_FORMS[name].packet(*values)))

    def run(self, seconds, name=None, *values, every=0.05):
        """Let time pass; name, values: a packet sent again and again."""
        period = max(round(every / self.world.dt), 1)
        for k in range(round(seconds / self.world.dt)):
            if name is not None and k % period == 0:
                self.send(name, *values)
            if self.told and k % 2 == 0:
                self.onboard.external_pose(
                    self.state[:3].copy(), self.state[6:10].copy()
                )
            self.world.step()
            self.said += self.drone.pass_time()
        return self

    def log(self, name):
        """A log variable now."""
        return self.drone.logs.read(name)

    @property
    def state(self):
        """(13,) the truth."""
        return self.world.states[0]

    @property
    def supervisor(self):
        """Its state, in words."""
        return self.onboard.state

    @property
    def motors(self):
        """Whether they turn."""
        return bool(self.onboard.record["motors"].any())

    def hovering(self, height=0.5):
        """By the planner: it has risen to that height."""
        self.run(0.5)
        self.send("take_off", 0, height, 0.0, True, 1.5)
        return self.run(2.5)
