"""Commands of ROS 2: services with receipts, and goals, in the bytes of an independent encoder."""

import struct

import numpy as np
import pytest
from observed_drones import ObserverPlace
from rosbags.typesys import Stores, get_typestore
from virtual_time import virtual
from zenoh_ros2_sdk.attachment import Attachment

from crazychoir.bridges.live_swarm import LiveSwarm
from crazychoir.bridges.ros_commands import GOAL_PERIOD, VELOCITY_PERIOD, RosCommands
from crazychoir.bridges.ros_node import RosNode
from crazychoir.bridges.ros_requests import read_goal, read_velocity
from crazychoir.dashboard.stick import STICK_TIMES
from crazychoir.errors import ConfigError
from crazychoir.runtime.clock import run_virtual

STORE = get_typestore(Stores.ROS2_JAZZY)
REQUEST = Attachment(5, 1_000, bytes(range(16))).to_bytes()


class Session:
    """A session with ROS, by name of service or topic."""

    id = "aabb"

    def __init__(self):
        self.tokens, self.services, self.topics = [], {}, {}

    def token(self, key):
        self.tokens.append(key)

    def put(self, key, data, attachment):
        raise AssertionError("commands publish nothing")

    def subscribe(self, key, receive):
        self.topics["/" + "/".join(key.split("/")[1:-2])] = receive

    def serve(self, key, handle):
        self.services["/" + "/".join(key.split("/")[1:-2])] = handle


class Query:
    def __init__(self, attachment=REQUEST):
        self.attachment, self.replies = attachment, []

    def reply(self, data, attachment):
        self.replies.append((data, Attachment.from_bytes(attachment)))

    @property
    def said(self):
        """(success, message), read by hand."""
        ((data, _),) = self.replies
        (length,) = struct.unpack_from("<I", data, 8)
        return bool(data[4]), data[12 : 12 + length - 1].decode()


def opened(clock):
    place, session = ObserverPlace(clock), Session()
    live = LiveSwarm(place)
    node = RosNode(session, 0, "crazychoir")
    commands = RosCommands(live, session, node, [3, 8])
    return place, session, commands


def twist(v=(1.0, 0.0, 0.0), yaw_rate=0.0, frame="world"):
    kinds = STORE.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    x, y, z = v
    linear = kinds["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)
    angular = kinds["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=yaw_rate)
    message = kinds["geometry_msgs/msg/TwistStamped"](
        header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=frame),
        twist=kinds["geometry_msgs/msg/Twist"](linear=linear, angular=angular),
    )
    return bytes(STORE.serialize_cdr(message, "geometry_msgs/msg/TwistStamped"))


def goal(x=1.0, yaw=0.0, frame="world", q=None):
    kinds = STORE.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    half = 0.5 * yaw
    x_q, y_q, z_q, w_q = q or (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
    pose = kinds["geometry_msgs/msg/Pose"](
        position=kinds["geometry_msgs/msg/Point"](x=x, y=0.5, z=1.0),
        orientation=kinds["geometry_msgs/msg/Quaternion"](x=x_q, y=y_q, z=z_q, w=w_q),
    )
    header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)
    message = kinds["geometry_msgs/msg/PoseStamped"](header=header, pose=pose)
    return bytes(STORE.serialize_cdr(message, "geometry_msgs/msg/PoseStamped"))


@virtual
async def test_a_service_answers_its_client_with_the_receipt(clock):
    place, session, _ = opened(clock)
    one, all_of_them = Query(), Query()
    session.services["/drone3/land"](one)
    await clock.sleep(1.0)
    session.services["/crazychoir/land"](all_of_them)
    await clock.sleep(1.0)
    assert one.said == (True, "drone 3: done: landed")
    assert all_of_them.said == (
        False,
        "drone 3: done: landed; drone 8: refused: it is on the ground",
    )
    assert [verb for verb, _ in place.told] == ["land", "land"]
    ((_, answer),) = one.replies
    assert (answer.sequence_id, answer.gid) == (5, bytes(range(16)))


@virtual
async def test_a_stop_stops_the_drones_that_it_names(clock):
    place, session, _ = opened(clock)
    one, all_of_them = Query(), Query()
    session.services["/drone8/stop"](one)
    await clock.sleep(1.0)
    assert (one.said, place.stopped) == ((True, "drone 8: done: motors off"), [8])
    session.services["/crazychoir/stop"](all_of_them)
    await clock.sleep(1.0)
    assert all_of_them.said[0]
    assert sorted(place.stopped[1:]) == [3, 8]


@virtual
async def test_a_request_of_another_form_is_not_carried_out(clock):
    place, session, _ = opened(clock)
    query = Query(b"none")
    session.services["/drone3/land"](query)
    await clock.sleep(1.0)
    assert (query.replies, place.told) == ([], [])


@virtual
async def test_the_newest_of_several_goals_is_flown_to(clock):
    place, session, _ = opened(clock)
    for x in (1.0, 2.0, 3.0):
        session.topics["/drone3/goal_pose"](goal(x, yaw=0.4))
    await clock.sleep(GOAL_PERIOD + 0.1)
    ((verb, told),) = place.told
    assert (verb, told["p"]) == ("go-to", [3.0, 0.5, 1.0])
    assert told["yaw"] == pytest.approx(0.4)


@pytest.mark.parametrize(
    "data", [goal(frame="map"), goal()[:30], b"", goal(float("nan")), goal(5000.0)]
)
def test_a_goal_that_cannot_be_flown_to_is_said_and_left(data, caplog):
    async def main(clock):
        place, session, _ = opened(clock)
        session.topics["/drone3/goal_pose"](data)
        await clock.sleep(1.0)
        return place.told

    assert run_virtual(main) == []
    assert "drone 3: its goal" in caplog.text


@virtual
async def test_a_stream_of_velocities_is_one_flight_by_hand(clock):
    place, session, _ = opened(clock)
    for k in range(1, 11):
        session.topics["/drone3/cmd_vel"](twist((0.1 * k, 0.0, 0.0), 0.2))
        await clock.sleep(0.01)
    await clock.sleep(2.0 * VELOCITY_PERIOD)
    assert {verb for verb, _ in place.told} == {"velocity"}
    assert 2 <= len(place.told) <= 4, "of quick messages the newest counts"
    told = place.told[-1][1]
    assert told["v"] == [1.0, 0.0, 0.0]
    assert (told["yaw_rate"], told["duration"]) == (0.2, STICK_TIMES.velocity_duration)


@virtual
async def test_zeros_end_a_flight_by_hand_once_and_disturb_no_other_flight(clock):
    place, session, _ = opened(clock)
    session.topics["/drone3/cmd_vel"](twist((0.0, 0.0, 0.0)))
    await clock.sleep(1.0)
    assert place.told == [], "a drone that does not fly by hand"
    place.delay = 0.3
    session.topics["/drone3/cmd_vel"](twist())
    for _ in range(20):
        await clock.sleep(0.05)
        session.topics["/drone3/cmd_vel"](twist((0.0, 0.0, 0.0)))
    assert [told["v"][0] for _, told in place.told] == [1.0, 0.0]


@pytest.mark.parametrize("frame", ["", "drone3"])
def test_a_velocity_in_the_frame_of_the_drone_turns_with_its_heading(frame):
    async def main(clock):
        place, session, _ = opened(clock)
        place.publish(0.0)  # heading along the y axis
        session.topics["/drone3/cmd_vel"](twist((1.0, 0.5, 0.2), frame=frame))
        await clock.sleep(2.0 * VELOCITY_PERIOD)
        return place.told[0][1]["v"]

    assert run_virtual(main) == pytest.approx([-0.5, 1.0, 0.2])


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (twist(frame="map"), "frame_id"),
        (twist(frame=""), "heading"),
        (twist()[:30], "cmd_vel is not flown"),
        (twist((float("nan"), 0.0, 0.0)), "cmd_vel is not flown"),
        (twist((50.0, 0.0, 0.0)), "cmd_vel is not flown"),
    ],
)
def test_a_velocity_that_cannot_be_flown_is_said_once_a_second(data, why, caplog):
    async def main(clock):
        place, session, _ = opened(clock)
        for _ in range(15):
            session.topics["/drone3/cmd_vel"](data)
            await clock.sleep(0.1)
        return place.told

    assert run_virtual(main) == []
    assert len(caplog.messages) == 2
    assert why in caplog.text


def test_refusal_of_a_velocity_is_logged(caplog):
    async def main(clock):
        _, session, _ = opened(clock)
        session.topics["/drone8/cmd_vel"](twist())
        await clock.sleep(1.0)

    run_virtual(main)
    assert "drone 8: cmd_vel: drone 8: refused: it is on the ground" in caplog.text


def test_roll_and_pitch_rates_do_not_count():
    asked = read_velocity(twist((0.1, 0.2, 0.3), 0.4), 3)
    assert (asked.v, asked.yaw_rate, asked.in_world) == ((0.1, 0.2, 0.3), 0.4, True)


def test_a_goal_without_an_attitude_keeps_the_yaw():
    assert read_goal(goal(q=(0.0, 0.0, 0.0, 0.0))) == {"p": [1.0, 0.5, 1.0]}
    with pytest.raises(ConfigError, match="world"):
        read_goal(goal(frame="base_link"))


@virtual
async def test_a_node_tells_ros_of_all_its_services(clock):
    _, session, _ = opened(clock)
    services = [token for token in session.tokens if "/SS/" in token]
    assert len(services) == len(session.services) == 9 + 2 * 5
    goals = [token for token in session.tokens if "/MS/" in token]
    assert len(goals) == len(session.topics) == 2 * 2
    numbers = [token.split("/")[4] for token in session.tokens]
    assert len(set(numbers)) == len(numbers)
