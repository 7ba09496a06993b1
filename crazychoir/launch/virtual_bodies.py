"""What a run has done to its virtual Crazyflies, by the server that simulates them.

The firmware reports a drone that lies on its back, but not a hard fall after which it stands.
"""

from collections.abc import Mapping
from typing import Any

from crazychoir.agent.mission_result import result_of_failure
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.uris import UDP_SCHEME, canonical_uri
from crazychoir.errors import Refused
from crazychoir.radio.virtual.control import ask_server


class VirtualBodies:
    """Compares the virtual Crazyflies of a run with how they were before it.

    A swarm without virtual cameras, or without an answer of their server, has no bodies.

    config: the swarm
    """

    def __init__(self, config: SwarmConfig) -> None:
        self._config = config
        self._impacts = {i: row["impact"] for i, row in self._ask().items()}

    def _ask(self) -> Mapping[int, dict[str, Any]]:
        """Return what the server says of each drone of the swarm."""
        uris = {canonical_uri(drone.uri): drone.id for drone in self._config.drones}
        mocap = self._config.mocap
        if mocap.source != "virtual" or not self._config.topology.reached:
            return {}
        try:
            answer = ask_server({"ask": "state"}, mocap.hostname, mocap.port)
        except (OSError, Refused):
            return {}
        rows = {
            canonical_uri(f"{UDP_SCHEME}{row['at'][0]}:{row['at'][1]}"): row
            for row in answer["drones"].values()
        }
        return {uris[uri]: row for uri, row in rows.items() if uri in uris}

    def find_crashes(self) -> dict[int, str]:
        """Return what has broken each drone since the beginning, or that it lies on its side.

        The speed of its fastest hit changes with a faster one, or begins anew where the drone is put
        elsewhere or started again.
        """
        crashes = {}
        for i, row in self._ask().items():
            if row["crashed"] and row["impact"] != self._impacts.get(i, 0.0):
                crashes[i] = str(row["crashed"])
            elif row["tumbled"]:
                crashes[i] = "tumbled: it lies on its side or its back"
        return crashes


def add_crashes(
    results: dict[int, dict[str, Any]], crashes: Mapping[int, str]
) -> dict[int, dict[str, Any]]:
    """Return the results of the drones, without success where a drone has crashed."""
    merged = dict(results)
    for i, text in crashes.items():
        own = results.get(i)
        if own is None:
            continue
        said = str(own.get("reason") or "")
        if text not in said:
            reason = f"{said}; {text}" if said else f"drone {i}: {text}"
            merged[i] = result_of_failure(reason, own)
    return merged
