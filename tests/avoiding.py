"""A drone with a collision filter, flown by the avoid stage of a tick, for tests of the filter."""

from crazychoir.flight.batch import MODE_NUMBERS, Batch, Course, FlightControllerKind
from crazychoir.flight.stages import avoid_drones
from crazychoir.safety.collision.avoidance import make_nearest, make_planes
from crazychoir.safety.collision.filter import CollisionFilter
from crazychoir.safety.rules.modes import Mode


class AvoidingDrone:
    """The only drone of a batch, with its collision filter.

    settings: [collision]
    traffic: what this drone knows of the others
    fence: from the floor upwards
    gains: (13,), as Gains.position
    """

    def __init__(self, settings, traffic, fence, gains):
        self.traffic = traffic
        self.batch = Batch(1)
        self.filter = CollisionFilter(
            settings,
            traffic,
            fence,
            a_max=2.0,
            v_max=1.0,
            ground=0.0,
            row=self.batch.avoids,
        )
        self.hearsay = self.filter.hearsay
        self.row = self.batch.avoids[0]
        self.planes = make_planes()
        self.near = make_nearest()
        drone = self.batch.drones[0]
        drone["ticks"] = 1
        drone["course"] = Course.FOLLOW
        drone["avoids"] = 1
        drone["listener"] = traffic.listener
        drone["gains"] = gains

    def fly_full_state(self, state, reference, now, lands=False):
        """Return the safe acceleration, (3,) m/s2; None if the drone may fly the full state (14,)."""
        drone = self.batch.drones[0]
        drone["controller"] = FlightControllerKind.TRACKER
        drone["mode"] = MODE_NUMBERS[Mode.LAND if lands else Mode.HOVER]
        drone["wanted"] = reference
        return self._avoid(state, now)

    def fly_acceleration(self, state, a, now):
        """Return the safe acceleration, (3,) m/s2; None if the drone may fly a, (3,) m/s2."""
        drone = self.batch.drones[0]
        drone["controller"] = FlightControllerKind.FOLLOWER
        drone["mode"] = MODE_NUMBERS[Mode.HOVER]
        drone["wanted"] = 0.0
        drone["wanted"][6:9] = a
        return self._avoid(state, now)

    def _avoid(self, state, now):
        batch = self.batch
        drone = batch.drones[0]
        drone["state"] = state.flat
        drone["acceleration"] = state.a
        airspace = self.traffic.airspace
        avoid_drones(
            batch.drones,
            batch.plans,
            batch.avoids,
            airspace.near.listeners,
            airspace.near.motions,
            now,
            self.planes,
            self.near,
            batch.drones["number"].copy(),
        )
        assert drone["evades"] == self.row["acts"]
        return drone["wanted"][6:9].copy() if drone["evades"] else None

    @property
    def is_cut_off(self):
        """Whether the drone hears at most half of all flying drones, itself included."""
        return bool(self.row["is_cut_off"])

    @property
    def gives_way_to(self):
        """Id of the nearest drone that this one last gave way to; None if it braked."""
        other = int(self.row["gives_way_to"])
        return None if other < 0 else other
