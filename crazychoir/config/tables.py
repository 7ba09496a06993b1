"""What may be written in a swarm file: its tables, keys, units, ranges and defaults.

Every key says what is allowed in its Meta: the reader checks with it and error texts quote it.
"""

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field

Id = Annotated[
    int, Meta(ge=0, le=9999, description="a drone id, 0 to 9999", examples=[3])
]
Ids = Annotated[
    tuple[Id, ...], Meta(description="a list of drone ids", examples=[[0, 1]])
]
Groups = Annotated[
    tuple[Annotated[tuple[Id, ...], Meta(min_length=1)], ...],
    Meta(
        description="lists of drone ids, none of them empty",
        examples=[[[0, 1], [2, 3]]],
    ),
]
Edges = Annotated[
    tuple[tuple[Id, Id], ...],
    Meta(description="pairs of drone ids", examples=[[[0, 1], [1, 2]]]),
]
Position = Annotated[
    tuple[float, float, float],
    Meta(description="a position [x, y, z] in m", examples=[[0.0, 0.6, 0.0]]),
]
Metres = Annotated[
    float, Meta(ge=0, description="a length in m, not negative", examples=[0.0005])
]
Height = Annotated[
    float,
    Meta(
        gt=0, le=100, description="a height in m, above 0, at most 100", examples=[1.0]
    ),
]
Level = Annotated[float, Meta(description="a height in m", examples=[0.0])]
Radians = Annotated[
    float, Meta(ge=-7, le=7, description="an angle in rad, -7 to 7", examples=[1.57])
]
Turn = Annotated[
    float, Meta(ge=0, le=1, description="an angle in rad, 0 to 1", examples=[0.001])
]
Speed = Annotated[
    float,
    Meta(
        gt=0, le=20, description="a speed in m/s, above 0, at most 20", examples=[1.0]
    ),
]
Acceleration = Annotated[
    float,
    Meta(
        gt=0,
        le=50,
        description="an acceleration in m/s2, above 0, at most 50",
        examples=[2.0],
    ),
]
Seconds = Annotated[
    float, Meta(ge=0, description="a time in s, not negative", examples=[0.02])
]
Timeout = Annotated[
    float, Meta(gt=0, description="a time in s, above 0", examples=[5.0])
]
Hertz = Annotated[
    float,
    Meta(
        gt=0, le=1000, description="a rate in Hz, above 0, at most 1000", examples=[100]
    ),
]
Probability = Annotated[
    float, Meta(ge=0, le=1, description="a probability, 0 to 1", examples=[0.1])
]
Flag = Annotated[bool, Meta(description="true or false", examples=[True])]
Text = Annotated[str, Meta(description="a text", examples=["scout"])]
Free = Annotated[
    dict[str, Any],
    Meta(description="a table of your own keys", examples=[{"speed": 0.5}]),
]
Name = Annotated[
    str,
    Meta(
        pattern=r"^[a-z0-9_-]{1,40}\Z",
        description="1 to 40 of a-z, 0-9, _ and -",
        examples=["lab6"],
    ),
]
Mission = Annotated[
    str,
    Meta(
        pattern=r"^([a-z][a-z0-9_]*|.+\.py)\Z",
        description="the name of a file in agents/, or the path of a .py file",
        examples=["pickup_delivery"],
    ),
]
Seed = Annotated[
    int, Meta(ge=0, description="a whole number, not negative", examples=[1])
]
Start = Annotated[
    Literal["all"] | Annotated[int, Meta(ge=1)],
    Meta(description='"all", or the number of drones that is enough', examples=["all"]),
]
Port = Annotated[
    int, Meta(ge=1024, le=65535, description="a port, 1024 to 65535", examples=[7460])
]
Burst = Annotated[
    float,
    Meta(
        ge=1,
        description="a mean number of messages lost in a row, 1 or more",
        examples=[4],
    ),
]
Bandwidth = Annotated[
    float, Meta(gt=0, description="bytes a second, above 0", examples=[50000])
]
Wind = Annotated[
    tuple[float, float, float],
    Meta(description="a velocity [x, y, z] in m/s", examples=[[0.5, 0.0, 0.0]]),
]
Gust = Annotated[
    float, Meta(ge=0, le=20, description="a speed in m/s, 0 to 20", examples=[0.3])
]
Mismatch = Annotated[
    float, Meta(ge=-0.5, le=0.5, description="a share, -0.5 to 0.5", examples=[0.05])
]
Tilt = Annotated[
    tuple[
        Annotated[float, Meta(ge=-0.5, le=0.5)], Annotated[float, Meta(ge=-0.5, le=0.5)]
    ],
    Meta(
        description="angles [roll, pitch] in rad, -0.5 to 0.5", examples=[[0.0175, 0.0]]
    ),
]
Centred = Annotated[
    float,
    Meta(ge=-0.5, le=0.5, description="a length in m, -0.5 to 0.5", examples=[0.02]),
]
SemiAxis = Annotated[
    float, Meta(ge=0.05, le=2, description="a length in m, 0.05 to 2", examples=[0.12])
]
Share = Annotated[
    float, Meta(gt=0, le=1, description="a share, above 0, at most 1", examples=[0.5])
]
Factor = Annotated[
    float, Meta(ge=0, le=100, description="a factor, 0 to 100", examples=[1.0])
]
Scale = Annotated[
    float,
    Meta(
        gt=0, le=1000, description="a factor, above 0, at most 1000", examples=[0.001]
    ),
]
Inputs = Annotated[
    Literal["rates", "euler"],
    Meta(
        description='what steers it: "rates" (of the body) or "euler" (of the Euler angles)',
        examples=["rates"],
    ),
]
Sender = Annotated[
    Literal["fpqr", "frpy", "vel", "xyz", "fullstate"],
    Meta(
        description='what is sent: "fpqr" (force, body rates), "frpy" (force, roll, pitch), "vel", "xyz" (places) or '
        '"fullstate" (references, flown by the firmware)',
        examples=["fpqr"],
    ),
]
Filter = Annotated[
    Literal["derivative", "kalman"],
    Meta(
        description='how velocities come from poses: "derivative" or "kalman"',
        examples=["kalman"],
    ),
]
Avoidance = Annotated[
    Literal["barrier", "cells", "off"],
    Meta(
        description='how drones keep clear of each other: "barrier", "cells" or "off"',
        examples=["cells"],
    ),
]
SemiAxes = Annotated[
    tuple[SemiAxis, SemiAxis, SemiAxis],
    Meta(description="three lengths in m, 0.05 to 2", examples=[[0.12, 0.12, 0.3]]),
]
Rate = Annotated[
    float,
    Meta(
        ge=0, le=1000, description="a rate in Hz, 0 (each tick) to 1000", examples=[50]
    ),
]
Hosts = Annotated[
    dict[str, str],
    Meta(
        description="a table of names and addresses",
        examples=[{"laptop": "192.168.1.10"}],
    ),
]
Names = Annotated[
    tuple[Name, ...], Meta(description="a list of names", examples=[["laptop"]])
]


Dongle = Annotated[
    int, Meta(ge=0, le=15, description="the number of a dongle, 0 to 15", examples=[0])
]
PoseFrom = Annotated[
    Literal["mocap", "onboard"],
    Meta(
        description='where its pose comes from: "mocap" or "onboard"',
        examples=["mocap"],
    ),
]
Body = Annotated[
    str,
    Meta(
        max_length=40,
        description="the name of a body, at most 40 characters",
        examples=["cf3"],
    ),
]
Offset = Annotated[
    tuple[Centred, Centred, Centred],
    Meta(description="three lengths in m, -0.5 to 0.5", examples=[[0.0, 0.0, 0.02]]),
]
Angles = Annotated[
    tuple[Radians, Radians, Radians],
    Meta(
        description="angles [roll, pitch, yaw] in rad, -7 to 7",
        examples=[[0.01, 0.0, 0.0]],
    ),
]
Source = Annotated[
    Literal["virtual", "replay", "vicon", "optitrack", "qualisys", "vrpn", "mock"],
    Meta(
        description='"virtual", "replay", "vicon", "optitrack", "qualisys", "vrpn" or "mock"',
        examples=["vicon"],
    ),
]
UdpPort = Annotated[
    int, Meta(ge=1, le=65535, description="a UDP port, 1 to 65535", examples=[19849])
]
PoseRate = Annotated[
    float,
    Meta(
        ge=10,
        le=100,
        description="a rate in Hz, 10 to 100: the onboard estimator needs 10",
        examples=[20],
    ),
]
Packets = Annotated[
    float, Meta(gt=0, le=5000, description="packets a second, above 0", examples=[250])
]
ThrustMap = Annotated[
    float,
    Meta(
        ge=10_000,
        le=1_000_000,
        description="thrust command a newton, all motors",
        examples=[136531],
    ),
]


class Table(Struct, frozen=True, kw_only=True):
    """A table of a swarm file."""


class Drone(Table, frozen=True, kw_only=True):
    """One [[drones]]: home is where it stands before the start, world frame; yaw rad; neighbors: whom it hears.

    uri: in which world it flies;  platform: which kind of Crazyflie it is. Of one that a radio reaches (udp://,
    radio://):  dongle: whose owner reaches it (without: that of its radio:// uri, 0 for udp://);  pose: who says where
    it is;  body: its name in the motion capture (without: "cf" and its id);  body_offset: m, of the tracked centre from
    its own, and body_rotation: roll, pitch, yaw rad, by which that body is mounted, see mocap/mounting.py;  parameters:
    of its firmware, set when it is connected, beside those of [radio].
    """

    id: Id
    home: Position
    uri: Text = "sim://"
    platform: Text = "paper"
    yaw: Radians = 0.0
    neighbors: Ids | None = None
    leader: Flag = False
    role: Text = ""
    host: Name | None = None
    options: Free = field(default_factory=dict)
    dongle: Dongle | None = None
    pose: PoseFrom = "mocap"
    body: Body = ""
    body_offset: Offset = (0.0, 0.0, 0.0)
    body_rotation: Angles = (0.0, 0.0, 0.0)
    parameters: Free = field(default_factory=dict)


class Link(Table, frozen=True, kw_only=True):
    """What happens to messages on their way.

    loss, duplicate, reorder: probability a message;  burst: mean length of a run of losses (without: independent);
    delay, jitter: s;  bandwidth: bytes/s.
    """

    loss: Probability | None = None
    burst: Burst | None = None
    delay: Seconds | None = None
    jitter: Seconds | None = None
    duplicate: Probability | None = None
    reorder: Probability | None = None
    bandwidth: Bandwidth | None = None


class Edge(Link, frozen=True, kw_only=True):
    """One [[network.edges]]: another rule for what `source` sends to `destination`; without one of them: any drone."""

    source: Id | None = None
    destination: Id | None = None


class Partition(Table, frozen=True, kw_only=True):
    """One [[network.partitions]]: groups don't hear each other from `at` to `until`; the unnamed are one more.

    at, until: s since GO.
    """

    at: Seconds
    groups: Groups
    until: Seconds | None = None


class Fence(Table, frozen=True, kw_only=True):
    """[fence]: the box, world frame, that no drone may leave."""

    min: Position = (-4.0, -4.0, 0.0)
    max: Position = (4.0, 4.0, 3.0)


class KeepOut(Table, frozen=True, kw_only=True):
    """[keep_out]: the limit area, world frame, beyond which motors stop at once; without it 0.5 m around the fence."""

    min: Position | None = None
    max: Position | None = None


class Flight(Table, frozen=True, kw_only=True):
    """[flight]: ground: height of the floor, world frame; takeoff_height: above it; limits of references;
    operator: drones wait for an operator's take-off, and their missions for his start;  dead_man: s without his console
    after which all land, 0 for never.
    """

    ground: Level = 0.0
    takeoff_height: Height = 1.0
    speed_limit: Speed = 1.0
    acceleration_limit: Acceleration = 2.0
    landing_speed: Speed = 0.3
    operator: Flag = False
    dead_man: Seconds = 0.0


class Mocap(Table, frozen=True, kw_only=True):
    """[mocap]: rate: poses a second; noise m, noise_angle rad: standard deviations an axis;
    dropout: probability a pose; latency: s, whole periods of the rate; tilt: (roll, pitch) rad, by which the body
    that the cameras know is mounted askew on the drone. Those are of simulated cameras. Of the cameras of drones that a
    radio reaches:  source: which system;  hostname, port: where it is (port: of "virtual");  file: of "replay", a
    recording (CSV), relative to the swarm file;  options: more that motioncapture's connect takes;
    connect_deadline: s that a system gets for that;  host: where crazychoir-mocap runs.
    """

    rate: Hertz = 100.0
    noise: Metres = 0.0005
    noise_angle: Turn = 0.001
    dropout: Probability = 0.0
    latency: Seconds = 0.0
    tilt: Tilt = (0.0, 0.0)
    source: Source = "virtual"
    hostname: Text = "127.0.0.1"
    port: UdpPort = 19849
    file: Text = ""
    options: Free = field(default_factory=dict)
    connect_deadline: Timeout = 5.0
    host: Name | None = None


class RadioHost(Table, frozen=True, kw_only=True):
    """One [[radio.dongles]]: on which host the owner of a dongle runs, and what the dongle carries."""

    dongle: Dongle
    host: Name | None = None
    capacity: Packets | None = None


Dongles = Annotated[
    tuple[RadioHost, ...],
    Meta(
        description="a list of tables [[radio.dongles]]",
        examples=[[{"dongle": 0, "host": "laptop"}]],
    ),
]


class Radio(Table, frozen=True, kw_only=True):
    """[radio]: how drones with a uri udp:// or radio:// are reached.

    capacity: packets a second of a dongle that several drones share;  command_rate: Hz of set-points, 0: as many as
    the dongles carry, at most a command each pose;  pose_rate: Hz of the poses that a drone is told;  log_rate: Hz of
    what it says of itself;  connect_deadline: s a drone;  watchdog: an XYZ drone whose radio fails cuts its motors
    after 1 s, and is locked until it is started anew, also when a run has ended; else it flies on;
    thrust_map: of all drones, for firmware whose release is not known;  parameters: of the
    firmware, of all drones;  origin: m, origin_yaw: rad, world frame: where the frame of poses that come from drones
    themselves (pose = "onboard") begins;  drift: whether a mission that needs a common frame may fly by such poses;
    dongles: their hosts.
    """

    capacity: Packets = 250.0
    command_rate: Rate = 0.0
    pose_rate: PoseRate = 10.0
    log_rate: Hertz = 10.0
    connect_deadline: Timeout = 10.0
    watchdog: Flag = False
    thrust_map: ThrustMap | None = None
    parameters: Free = field(default_factory=dict)
    origin: Position = (0.0, 0.0, 0.0)
    origin_yaw: Radians = 0.0
    drift: Flag = False
    dongles: Dongles = ()


class Plant(Table, frozen=True, kw_only=True):
    """[plant]: a simulated drone. In every world: command_delay: s until it obeys;  mass_error, thrust_error: shares by
    which it is heavier and pulls harder than its platform, for which its controllers are made. Of the lightweight one:
    inputs;  rate_lag: time constant of its body rates.
    """

    inputs: Inputs = "rates"
    rate_lag: Seconds = 0.03
    command_delay: Seconds = 0.02
    mass_error: Mismatch = 0.0
    thrust_error: Mismatch = 0.0


class Motors(Table, frozen=True, kw_only=True):
    """[motors]: the motor-level world.

    wind: m/s, world;  gusts: m/s, standard deviation an axis, each lasting gust_time s;  ground_effect, downwash:
    whether they act;  battery: charge at the start, 1 is full;  imu_noise: of the sensors, 1 is the data sheet's;
    floor_tilt: (roll, pitch) rad, about the world's axes, of what is under each drone.
    """

    wind: Wind = (0.0, 0.0, 0.0)
    gusts: Gust = 0.0
    gust_time: Timeout = 2.0
    ground_effect: Flag = True
    downwash: Flag = True
    battery: Share = 1.0
    imu_noise: Factor = 1.0
    floor_tilt: Tilt = (0.0, 0.0)


class Mujoco(Table, frozen=True, kw_only=True):
    """[mujoco]: the shapes in mujoco://, beside [motors].

    model: a file of a drone's shape (STL, OBJ, URDF, MJCF), empty: our own;  body: its body, if it has several;
    scale: of its lengths, 0.001 for millimetres;  scene: an MJCF of what stands in the room. Paths are relative to the
    swarm file.
    """

    model: Text = ""
    body: Text = ""
    scale: Scale = 1.0
    scene: Text = ""


class World(Table, frozen=True, kw_only=True):
    """[world]: the process that owns the simulated world, in real time.

    owned: also of lightweight drones, which otherwise fly in their agents;  host: where it runs;  options: for an
    engine of others.
    """

    owned: Flag = False
    host: Name | None = None
    options: Free = field(default_factory=dict)


class Collision(Table, frozen=True, kw_only=True):
    """[collision]: how drones keep clear of each other.

    method: "off", "barrier" (two together can always stop) or "cells" (each can, on its side of the middle);
    semi_axes: m, of the ellipsoid around each drone, which no other's meets: it is tall because of the downwash;
    margin: m, kept beyond twice the first of them;  slack: m, beyond that, between drones that fly agreed ways (those
    that are sent "xyz", "vel" or "fullstate");  brake: m/s2, with which a drone counts on being able to brake;
    stiff, gamma: 1/s, how fast a gap closes at most, and how fast that limit is come to;  turn: how much a drone goes
    to the side where somebody is in its way;  range: m, within which others count;  unsure: m/s2, by which one that is
    not heard may change its acceleration;  lag, delay: s, with which drones obey.
    """

    method: Avoidance = "barrier"
    semi_axes: SemiAxes = (0.12, 0.12, 0.3)
    margin: Metres = 0.08
    slack: Metres = 0.02
    brake: Acceleration = 1.0
    gamma: Timeout = 4.0
    turn: Factor = 1.0
    range: Height = 2.0
    unsure: Factor = 2.0
    lag: Seconds = 0.05
    delay: Seconds = 0.05
    stiff: Timeout = 1.5


class Control(Table, frozen=True, kw_only=True):
    """[control]: sender: what the drone is sent, none: "fpqr", or "frpy" to one that a radio reaches;  gains: of the
    tracking controller, instead of the standard;  position_rate: Hz, of the position strategy, 0: each tick;  filter:
    of the poses.
    """

    sender: Sender | None = None
    gains: Free = field(default_factory=dict)
    position_rate: Rate = 0.0
    filter: Filter = "kalman"


class Role(Control, frozen=True, kw_only=True):
    """One [[roles]]: a [control] of its own for the drones with this `role`."""

    name: Text


Roles = Annotated[
    tuple[Role, ...],
    Meta(
        description="a list of tables [[roles]]",
        examples=[[{"name": "scout", "sender": "frpy"}]],
    ),
]
Drones = Annotated[
    tuple[Drone, ...],
    Meta(
        description="a list of drones: one table [[drones]] each",
        examples=[[{"id": 0, "home": [0.0, 0.6, 0.0]}]],
    ),
]
LinkEdges = Annotated[
    tuple[Edge, ...],
    Meta(
        description="a list of tables [[network.edges]]",
        examples=[[{"source": 0, "destination": 1, "loss": 0.1}]],
    ),
]
Partitions = Annotated[
    tuple[Partition, ...],
    Meta(
        description="a list of tables [[network.partitions]]",
        examples=[[{"at": 5.0, "groups": [[0, 1]]}]],
    ),
]


class Network(Link, frozen=True, kw_only=True):
    """[network]: a simulated bad network between the drones; what is not written is perfect."""

    edges: LinkEdges = ()
    partitions: Partitions = ()


class Security(Table, frozen=True, kw_only=True):
    """[security]: of the network between hosts, which is encrypted and closed as soon as one is not this machine.

    insecure: true: neither; false: on this machine, too;  keys: the folder of `crazychoir keys`, relative to the swarm
    file;  operators: names of certificates whose hosts may command.
    """

    insecure: Flag | None = None
    keys: Text = "keys"
    operators: Names = ()


BASE_PORT = 7460  # without one in the swarm file


class Swarm(Table, frozen=True, kw_only=True):
    """A swarm file. SI units, world frame; see deploy/README.md."""

    name: Name
    drones: Drones
    mission: Mission | None = None
    mission_options: Free = field(default_factory=dict)
    seed: Seed = 0
    topology: Text | None = field(default=None, name="graph")
    edges: Edges | None = None
    directed: Flag = False
    start: Start = "all"
    start_deadline: Timeout = 30.0
    lost_after: Timeout = 5.0
    lease: Timeout = 1.0
    base_port: Port = BASE_PORT
    processes: Groups | None = None
    hosts: Hosts = field(default_factory=dict)
    router: Name | None = None
    security: Security = Security()
    network: Network = Network()
    flight: Flight = Flight()
    fence: Fence = Fence()
    keep_out: KeepOut = KeepOut()
    mocap: Mocap = Mocap()
    radio: Radio = Radio()
    plant: Plant = Plant()
    motors: Motors = Motors()
    mujoco: Mujoco = Mujoco()
    world: World = World()
    collision: Collision = Collision()
    control: Control = Control()
    roles: Roles = ()


OWN_TO_A_HOST = ("hosts", "router", "security", "base_port", "network")
"""What hosts need not agree on: how they reach each other, and what is simulated to happen to their messages."""
AGREED = tuple(
    key for key in Swarm.__struct_encode_fields__ if key not in OWN_TO_A_HOST
)
"""All other keys of a swarm file."""
OF_BODIES = (
    "drones",
    "flight",
    "fence",
    "keep_out",
    "radio",
    "plant",
    "motors",
    "mujoco",
    "world",
    "control",
    "roles",
)
"""What those who own bodies or cameras, which know no mission, agree on with those who fly."""
