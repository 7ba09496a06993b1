"""crazychoir: swarms of Crazyflie quadrotors that optimise and fly together, without ROS."""

from crazychoir.errors import CrazyChoirError
from crazychoir.guidance.base import CFDistributedFeedback, CFGuidance
from crazychoir.guidance.pickup_delivery import PDVRPGuidance
from crazychoir.swarm.communicator import Communicator
from crazychoir.swarm.config import SwarmConfig
from crazychoir.swarm.graph import Graph, GraphSequence
from crazychoir.swarm.round import Round
from crazychoir.types import FPQR, Acceleration, FullState, Goto, PerNeighbor, Pose, State

__all__ = [
    "FPQR",
    "Acceleration",
    "CFDistributedFeedback",
    "CFGuidance",
    "Communicator",
    "CrazyChoirError",
    "FullState",
    "Goto",
    "Graph",
    "GraphSequence",
    "PDVRPGuidance",
    "PerNeighbor",
    "Pose",
    "Round",
    "State",
    "SwarmConfig",
]
