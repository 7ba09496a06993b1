"""Definitions of the ROS 2 messages in a recording."""

MESSAGE_DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/String": "string data",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "nav_msgs/Odometry": """\
std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist""",
    "crazychoir_msgs/Acceleration": """\
std_msgs/Header header
geometry_msgs/Vector3 a  # m/s2, world
float64 yaw  # rad""",
    "crazychoir_msgs/FullState": """\
std_msgs/Header header
geometry_msgs/Point p  # m, world
geometry_msgs/Vector3 v  # m/s
geometry_msgs/Vector3 a  # m/s2
geometry_msgs/Vector3 j  # m/s3
float64 yaw  # rad
float64 yaw_rate  # rad/s""",
    "crazychoir_msgs/Goto": """\
std_msgs/Header header
geometry_msgs/Point p  # m, world
float64 yaw  # rad
float64 duration  # s, 0: as fast as the limits allow""",
    "crazychoir_msgs/FPQR": """\
std_msgs/Header header
float64 thrust  # N, along the body's z
geometry_msgs/Vector3 rates  # p, q, r rad/s, body""",
    "crazychoir_msgs/FRPY": """\
std_msgs/Header header
float64 thrust  # N, along the body's z
float64 roll  # rad
float64 pitch  # rad, positive: nose down
float64 yaw_rate  # rad/s""",
    "crazychoir_msgs/Vel": """\
std_msgs/Header header
geometry_msgs/Vector3 v  # m/s, world
float64 yaw_rate  # rad/s""",
    "crazychoir_msgs/Velocity": """\
std_msgs/Header header
geometry_msgs/Vector3 v  # m/s, world
float64 yaw  # rad""",
    "crazychoir_msgs/Acc": """\
std_msgs/Header header
geometry_msgs/Vector3 a  # m/s2, world""",
    "crazychoir_msgs/Drive": """\
std_msgs/Header header
float64 v  # m/s, along the heading
float64 w  # rad/s""",
    "crazychoir_msgs/XYZ": """\
std_msgs/Header header
string verb
geometry_msgs/Point p  # m, world
float64 yaw  # rad
float64 duration  # s""",
    "crazychoir_msgs/Body": """\
std_msgs/Header header
string harm  # what has broken it
bool flying  # in the air, flown there by commands
bool cut  # its motors are off until its world is started again""",
    "crazychoir_msgs/LinkStatus": """\
std_msgs/Header header
string state  # connecting, up, degraded, lost, absent or refused
float64 silence  # s
float64 latency  # s
float64 answered  # share of packets
float64 rssi  # dBm
float64 battery  # V
int64 supervisor  # bits of the firmware's
bool flying
string[] problems  # why it may not take off
string release  # of the firmware
int64 refused  # plans
int64 reconnected
string astray  # how its body moves otherwise than it does""",
    "crazychoir_msgs/Status": """\
std_msgs/Header header
string phase
string task
int64 round
float64 cost  # NaN before there is a plan
float64 relaxed  # value of its relaxation, else NaN
int64 sent
int64 lost
int64 resent
int64 dropped
int64[] suspect
int64[] gone
string process
string host
string note
bool stopped  # an emergency stop of the swarm is in force
bool grave  # the operator should act upon the note
string[] hosts  # others
float64[] offsets  # s, how far their clocks are ahead
float64[] offset_errors  # s
string[] link_faults  # name and count of what went wrong on the link of its process""",
    "crazychoir_msgs/Value": """\
std_msgs/Header header
string json  # null for what is not finite""",
    "crazychoir_msgs/Round": """\
std_msgs/Header header
int64 to  # the drone that it arrived at
int64 round
int64 epoch  # of the team
string kind
string channel
string json  # what was exchanged; empty where the kind has no content""",
}
"""Definitions of standard messages as in ROS 2 Humble to Jazzy, without comments; and our own."""
