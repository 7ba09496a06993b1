"""The questions about virtual drones that the port of their cameras answers."""

import json
from collections.abc import Callable, Mapping
from typing import Any

from crazychoir.bus.json_view import to_plain_values
from crazychoir.errors import CodecError
from crazychoir.numerics.math3d import yaw_of
from crazychoir.radio.virtual.fault_control import FaultControl
from crazychoir.radio.virtual.faults import Faults
from crazychoir.radio.virtual.port import DronePort
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld

ANSWER_SIZE = 48_000
"""Most bytes of the rows of drones in one answer. With the rest of the answer they fit into a
datagram.
"""


class ServerQuestions:
    """Answers questions about the state and the faults of virtual drones, and sets faults.

    ports: ports by drone
    faults: faults by drone
    control: sets faults
    """

    def __init__(
        self,
        world: CrazyflieWorld,
        ports: Mapping[int, DronePort],
        faults: Mapping[int, Faults],
        control: FaultControl,
    ) -> None:
        self._world = world
        self._ports = ports
        self._faults = faults
        self._control = control

    def answer(self, question: Mapping[str, Any]) -> Any:
        """Answer a question at the cameras' port.

        The questions are:

            {"ask": "state"}
            {"ask": "faults"}
            {"faults": {"3,4": {"loss": 0.3}}}

        The first two are answered in parts: see `_select_part`.
        """
        if "faults" in question:
            self._control.set_faults(question["faults"])
            return {"done": True}
        match question.get("ask"):
            case "state":
                return {
                    "time": self._world.time,
                    **self._select_part(question, self.describe_drone),
                }
            case "faults":
                return self._select_part(question, lambda i: self._faults[i].listed())
        allowed = '{"ask": "state"}, {"ask": "faults"}, {"faults": {id: {name: value}}}'
        raise CodecError(f"a question: {dict(question)}; allowed: {allowed}.")

    def _select_part(
        self, question: Mapping[str, Any], row_of: Callable[[int], Any]
    ) -> dict[str, Any]:
        """Return as many drones as a datagram holds, and whether more follow.

        The first is the drone after "after". The answer repeats "after", which distinguishes it
        from the answer to another question.

        row_of: returns the row of a drone
        """
        ids = list(self._ports)
        after = question.get("after")
        left = ids[ids.index(after) + 1 :] if after in ids else ids
        drones: dict[int, Any] = {}
        size = 0
        for i in left:
            row = row_of(i)
            size += len(json.dumps({i: to_plain_values(row)}))
            if drones and size > ANSWER_SIZE:
                break
            drones[i] = row
        said = {} if after is None else {"after": after}
        return {
            "drones": drones,
            **said,
            **({"more": True} if len(drones) < len(left) else {}),
        }

    def describe_drone(self, i: int) -> dict[str, Any]:
        """Return the true state of a drone, and what it has received."""
        port = self._ports[i]
        row = self._world.row[i]
        world = self._world
        drone = port.drone
        told = drone.flight.told
        x = self._world.states[self._world.row[i]]
        record = self._world.onboard[i].record
        up = 1.0 - 2.0 * (x[6] ** 2 + x[7] ** 2)
        return {
            "p": x[:3].tolist(),
            "v": x[3:6].tolist(),
            "q": x[6:10].tolist(),
            "yaw": float(yaw_of(x[6:10])),
            "estimate": [float(record[axis]) for axis in ("x", "y", "z")],
            "supervisor": "off" if self._faults[i].off else drone.onboard.state,
            "info": drone.flight.info,
            "motors": [float(share) for share in record["motors"]],
            "vbat": world.vbat(i),
            "zeros": drone.flight.zeros,
            "last": drone.flight.last,
            "poses": told.count,
            "pose_age": told.age if told.count else None,
            "longest_pose_gap": told.longest_gap,
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
