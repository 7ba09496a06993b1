"""What a run has done to its virtual Crazyflies; their server is a stand-in."""

import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused
from crazychoir.launch.virtual_bodies import VirtualBodies, add_crashes


def swarm(source="virtual"):
    drones = [
        {"id": i, "home": [0, i, 0], "uri": f"udp://127.0.0.1:{19850 + i}/"}
        for i in (3, 2, 1)
    ]
    mocap = {"source": source, "port": 19840}
    return SwarmConfig.of({"name": "lab", "drones": drones, "mocap": mocap})


def body(port, impact=0.0, tumbled=False):
    crashed = f"crashed: hit the floor at {impact:.2f} m/s" if impact > 1.0 else ""
    at = ["127.0.0.1", port]
    return {"at": at, "crashed": crashed, "tumbled": tumbled}


@pytest.fixture
def server(monkeypatch):
    """Return the drones of the server, by the ids that it gives to them."""
    drones = {}

    def ask(question, host, port):
        assert (host, port) == ("127.0.0.1", 19840)
        if not drones:
            raise Refused("server", "no answer")
        for names, faults in question.get("faults", {}).items():
            assert faults == {"mend": 1}
            for name in names.split(","):
                drones[name] |= {"crashed": ""}
        return {"drones": drones}

    monkeypatch.setattr("crazychoir.launch.virtual_bodies.ask_server", ask)
    return drones


def test_a_fall_in_the_run_is_found_and_one_before_it_is_not(server):
    server |= {"0": body(19851), "1": body(19852, 3.0), "2": body(19853, 3.0)}
    bodies = VirtualBodies(swarm())
    server["0"] = body(19851, 2.5)
    server["2"] = body(19853, 2.8)
    assert bodies.find_crashes() == {
        1: "crashed: hit the floor at 2.50 m/s",
        3: "crashed: hit the floor at 2.80 m/s",
    }


def test_falls_of_drones_of_another_swarm_are_not_forgotten(server):
    server |= {"0": body(19851, 3.0), "7": body(19870, 3.0)}
    VirtualBodies(swarm())
    assert server["7"]["crashed"]


def test_a_drone_that_lies_overturned_is_found(server):
    server |= {"0": body(19851, 0.2, tumbled=True)}
    found = VirtualBodies(swarm()).find_crashes()
    assert found == {1: "tumbled: it lies on its side or its back"}


def test_a_swarm_without_a_server_of_virtual_drones_has_no_crashes(server):
    assert VirtualBodies(swarm()).find_crashes() == {}
    server |= {"0": body(19851, 2.0)}
    assert VirtualBodies(swarm("vicon")).find_crashes() == {}


def test_a_drone_that_has_crashed_has_no_success():
    results = {
        1: {"success": True, "place": [0.0]},
        2: {"success": False, "reason": "drone 2: crashed"},
        3: {"success": False, "reason": "late"},
    }
    merged = add_crashes(results, dict.fromkeys((1, 2, 3, 4), "crashed"))
    assert merged == {
        1: {"success": False, "place": [0.0], "reason": "drone 1: crashed"},
        2: {"success": False, "reason": "drone 2: crashed"},
        3: {"success": False, "reason": "late; crashed"},
    }
