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
    """Finds the falls of virtual Crazyflies in a run.

    A swarm without virtual cameras, or without an answer of their server, has no bodies.
    The server forgets earlier falls of these drones: it keeps the fastest one alone.

    config: the swarm
    """

    def __init__(self, config: SwarmConfig) -> None:
        self._config = config
        names = ",".join(name for name, _ in self._list_rows().values())
        if names:
            self._ask({"faults": {names: {"mend": 1}}})

    def _list_rows(self) -> dict[int, tuple[str, dict[str, Any]]]:
        """Return the server's name of each drone of the swarm, and what it says of it."""
        uris = {canonical_uri(drone.uri): drone.id for drone in self._config.drones}
        answer = self._ask({"ask": "state"})
        found = {
            canonical_uri(f"{UDP_SCHEME}{row['at'][0]}:{row['at'][1]}"): (name, row)
            for name, row in answer.get("drones", {}).items()
        }
        return {uris[uri]: row for uri, row in found.items() if uri in uris}

    def _ask(self, question: dict[str, Any]) -> dict[str, Any]:
        """Return the server's answer; an empty one without virtual cameras or a server."""
        mocap = self._config.mocap
        if mocap.source != "virtual" or not self._config.topology.reached:
            return {}
        try:
            return ask_server(question, mocap.hostname, mocap.port)
        except (OSError, Refused):
            return {}

    def find_crashes(self) -> dict[int, str]:
        """Return what has broken each drone since the beginning, or that it lies on its side."""
        crashes = {}
        for i, (_, row) in self._list_rows().items():
            if row["crashed"]:
                crashes[i] = str(row["crashed"])
            elif row["tumbled"]:
                crashes[i] = "tumbled: it lies on its side or its back"
        return crashes


def add_crashes(
    results: dict[int, dict[str, Any]], crashes: Mapping[int, str]
) -> dict[int, dict[str, Any]]:
    """Return the results of the drones, without success where a drone has crashed."""
    merged = dict(results)
    for i, own in results.items():
        said = str(own.get("reason") or "")
        text = crashes.get(i, "")
        if text not in said:
            merged[i] = result_of_failure(
                f"{said}; {text}" if said else f"drone {i}: {text}", own
            )
    return merged


def explain_absent(flown: dict[str, Any], crashes: Mapping[int, str]) -> None:
    """Add what has broken them to the reasons of the drones without a result.

    flown: object that `run --json` prints, see summarise_flight; changed
    """
    for i in flown["absent"]:
        if i in crashes:
            flown["reasons"][i] += f"; {crashes[i]}"
