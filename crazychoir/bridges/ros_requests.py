"""Goals and velocities as programs of ROS 2 send them."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import yaw_of
from crazychoir.recording.mcap.cdr import leaves, unpack_values
from crazychoir.recording.ros.ros import ROS_DEFINITIONS
from crazychoir.recording.ros.rviz import RVIZ_SETTINGS
from crazychoir.recording.ros.scene import drone_frame
from crazychoir.types import Point

GOAL_TYPE = "geometry_msgs/msg/PoseStamped"
VELOCITY_TYPE = "geometry_msgs/msg/TwistStamped"
_GOAL_FIELDS = list(leaves("geometry_msgs/PoseStamped", ROS_DEFINITIONS))
_VELOCITY_FIELDS = list(leaves("geometry_msgs/TwistStamped", ROS_DEFINITIONS))


def read_goal(data: bytes) -> dict[str, Any]:
    """Return the fields of a go-to for a geometry_msgs/PoseStamped: its place and its yaw.

    Raises ConfigError for another frame than the world, and struct.error, IndexError or
    UnicodeDecodeError for bytes of another message.
    """
    values = unpack_values(_GOAL_FIELDS, data)
    frame = values["header.frame_id"]
    if frame not in ("", RVIZ_SETTINGS.frame):
        raise ConfigError("goal_pose: frame_id", frame, RVIZ_SETTINGS.frame)
    place = [values[f"pose.position.{axis}"] for axis in "xyz"]
    q = np.array([values[f"pose.orientation.{axis}"] for axis in "xyzw"])
    has_attitude = 0.5 < np.linalg.norm(q) < 2.0
    return {"p": place} | ({"yaw": yaw_of(q)} if has_attitude else {})


@dataclass(frozen=True)
class RosVelocity:
    """A velocity of a geometry_msgs/TwistStamped."""

    v: Point
    """(3,) m/s: x, y, z up."""
    yaw_rate: float
    """rad/s."""
    in_world: bool
    """Whether x and y are those of the world; else x is the heading of the drone, and y its left."""

    def in_the_world(self, yaw: float) -> Point:
        """Return the velocity (3,) in the world, m/s.

        yaw: rad, heading of the drone
        """
        if self.in_world:
            return self.v
        x, y, z = self.v
        c = math.cos(yaw)
        s = math.sin(yaw)
        return (c * x - s * y, s * x + c * y, z)


def read_velocity(data: bytes, i: int) -> RosVelocity:
    """Return the velocity of a geometry_msgs/TwistStamped for drone i.

    The frame is the world, or the drone's own, which is also meant by no frame. Roll and pitch
    rates do not count.

    Raises ConfigError for another frame, and struct.error, IndexError or UnicodeDecodeError for
    bytes of another message.
    """
    values = unpack_values(_VELOCITY_FIELDS, data)
    frame = values["header.frame_id"]
    world = RVIZ_SETTINGS.frame
    own = drone_frame(i)
    if frame not in ("", own, world):
        raise ConfigError("cmd_vel: frame_id", frame, f"{world}, {own}, or none")
    v = (
        values["twist.linear.x"],
        values["twist.linear.y"],
        values["twist.linear.z"],
    )
    return RosVelocity(v, values["twist.angular.z"], in_world=frame == world)
