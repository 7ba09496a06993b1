"""Three drones as cflib's Swarm flies them."""

import time

from cflib.crazyflie.swarm import CachedCfFactory, Swarm


def _hop(scf, height):
    scf.cf.high_level_commander.takeoff(height, 1.0)
    time.sleep(1.4)
    scf.cf.high_level_commander.land(0.0, 1.0)
    time.sleep(1.3)
    scf.cf.high_level_commander.stop()


def three(uris, cache):
    """In parallel, each with arguments of its own; one after the other; where they are."""
    with Swarm(uris, factory=CachedCfFactory(rw_cache=cache)) as swarm:
        swarm.reset_estimators()
        places = swarm.get_estimated_positions()
        assert len({round(place.x, 1) for place in places.values()}) > 1, places
        swarm.parallel_safe(
            _hop, args_dict={uri: [0.3 + 0.1 * k] for k, uri in enumerate(uris)}
        )
        swarm.sequential(lambda scf: scf.cf.param.set_value("led.bitmask", 255))
