"""The tables and keys of a swarm file, with their units, ranges and defaults.

The Meta of every key states its allowed values. The reader checks values against it, and error
texts quote it.
"""

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field

from crazychoir.errors import ConfigError

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
Distance = Annotated[
    float,
    Meta(
        gt=0,
        le=100,
        description="a distance in m, above 0, at most 100",
        examples=[2.0],
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
ClosingRate = Annotated[
    float, Meta(gt=0, description="a rate in 1/s, above 0", examples=[1.5])
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
    Meta(description='"all", or the smallest number of drones', examples=["all"]),
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
SpeedMoment = Annotated[
    float,
    Meta(
        ge=0,
        le=100,
        description="an angular acceleration in rad/s2 per m/s, 0 to 100",
        examples=[34.0],
    ),
]
Damping = Annotated[
    float, Meta(ge=0, le=100, description="a damping in 1/s, 0 to 100", examples=[3.0])
]
Imbalance = Annotated[
    float, Meta(ge=0, le=0.5, description="a share, 0 to 0.5", examples=[0.1])
]
AngularAcceleration = Annotated[
    float,
    Meta(
        ge=0,
        le=100,
        description="an angular acceleration in rad/s2, 0 to 100",
        examples=[3.0],
    ),
]
Unrest = Annotated[
    float,
    Meta(ge=0, le=10, description="an acceleration in m/s2, 0 to 10", examples=[0.07]),
]
AccelerationChange = Annotated[
    float,
    Meta(ge=0, le=100, description="an acceleration in m/s2, 0 to 100", examples=[2.0]),
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
        description='the commands that steer it: "rates" (of the body) or "euler" (of the Euler angles)',
        examples=["rates"],
    ),
]
Sender = Annotated[
    Literal["fpqr", "frpy", "vel", "xyz", "fullstate"],
    Meta(
        description='the kind of commands: "fpqr" (force, body rates), "frpy" (force, roll, pitch), "vel", '
        '"xyz" (places) or "fullstate" (references, flown by the firmware)',
        examples=["fpqr"],
    ),
]
Filter = Annotated[
    Literal["derivative", "kalman"],
    Meta(
        description='the estimator of velocities: "derivative" or "kalman"',
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
        description='the source of its pose: "mocap" or "onboard"',
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


DroneName = Annotated[
    str,
    Meta(
        pattern=r"^[A-Za-z0-9_.-]{0,40}\Z",
        description="at most 40 of A-Z, a-z, 0-9, _, . and -",
        examples=["cf231"],
    ),
]
Volts = Annotated[
    float,
    Meta(ge=2.5, le=4.5, description="a voltage in V, 2.5 to 4.5", examples=[3.8]),
]
Variables = Annotated[
    tuple[
        Annotated[str, Meta(pattern=r"^[A-Za-z0-9_]+\.[A-Za-z0-9_]+\Z")],
        ...,
    ],
    Meta(
        min_length=1,
        description="a list of log variables, each GROUP.NAME",
        examples=[["pm.vbat", "stabilizer.roll"]],
    ),
]
LogRate = Annotated[
    float,
    Meta(
        ge=0.4,
        le=100,
        description="a rate in Hz, 0.4 to 100",
        examples=[10],
    ),
]
ThrustFactor = Annotated[
    float,
    Meta(ge=0.3, le=2.0, description="a share, 0.3 to 2", examples=[0.93]),
]
MotorFactor = Annotated[float, Meta(ge=0.5, le=1.5)]
MotorFactors = Annotated[
    tuple[MotorFactor, MotorFactor, MotorFactor, MotorFactor],
    Meta(description="four shares, 0.5 to 1.5", examples=[[1.02, 0.98, 1.01, 0.99]]),
]
RotorLag = Annotated[
    float,
    Meta(ge=0.005, le=0.3, description="a time in s, 0.005 to 0.3", examples=[0.06]),
]
RotorDelay = Annotated[
    float, Meta(ge=0, le=0.1, description="a time in s, 0 to 0.1", examples=[0.01])
]
Drag = Annotated[float, Meta(ge=0, le=0.2)]
Drags = Annotated[
    tuple[Drag, Drag, Drag],
    Meta(
        description="three drags in kg/s, 0 to 0.2",
        examples=[[0.0123, 0.0126, 0.0128]],
    ),
]
AirMoment = Annotated[float, Meta(ge=-0.01, le=0.01)]
AirMoments = Annotated[
    tuple[AirMoment, AirMoment],
    Meta(
        description="two moments in N m per m/s, -0.01 to 0.01",
        examples=[[0.00055, 0.00059]],
    ),
]
RateDamping = Annotated[float, Meta(ge=0, le=0.01)]
RateDampings = Annotated[
    tuple[RateDamping, RateDamping, RateDamping],
    Meta(
        description="three dampings in N m per rad/s, 0 to 0.01",
        examples=[[0.00005, 0.00005, 0.0]],
    ),
]
Noise = Annotated[float, Meta(ge=0, le=1)]
Noises = Annotated[
    tuple[Noise, Noise, Noise],
    Meta(
        description="three deviations in m, rad and rad/s, 0 to 1",
        examples=[[0.0001, 0.0017, 0.004]],
    ),
]
Resistance = Annotated[
    float,
    Meta(ge=0.001, le=2, description="ohm, 0.001 to 2", examples=[0.15]),
]
Capacity = Annotated[
    float, Meta(ge=1, le=100_000, description="A s, 1 to 100000", examples=[900])
]


class SwarmTable(Struct, frozen=True, kw_only=True):
    """Base of all tables of a swarm file."""


class CalibrationTable(SwarmTable, frozen=True, kw_only=True):
    """[drones.calibration]: what `crazychoir calibrate` found about this drone.

    Simulated bodies have it, and controllers know it. A key that is left out is as in the platform.
    """

    thrust_factor: ThrustFactor | None = None
    """True thrust as a share of the platform's."""
    motor_factors: MotorFactors | None = None
    """(4,): thrust of motors 1 to 4 as a share of their mean."""
    trim: Tilt | None = None
    """rad, roll and pitch: rotation from the thrust axis to the tracked body, in addition to body_rotation."""
    rotor_lag: RotorLag | None = None
    """s: time constant of the rotors."""
    rotor_delay: RotorDelay | None = None
    """s: time constant of a second lag, before the rotors."""
    drag: Drags | None = None
    """(3,) kg/s, body axes."""
    speed_moment: AirMoments | None = None
    """(2,) N m per m/s: moments about x and y that speed makes, see platforms.py."""
    rate_damping: RateDampings | None = None
    """(3,) N m per rad/s, body axes."""
    noise: Noises | None = None
    """m, rad, rad/s: noise of place, angles and gyroscope in flight; simulated cameras have the first two."""
    battery_resistance: Resistance | None = None
    """ohm."""
    battery_capacity: Capacity | None = None
    """A s."""


class SharedDroneTable(SwarmTable, frozen=True, kw_only=True):
    """[defaults]: values for all [[drones]], which may have other ones."""

    uri: Text = "sim://"
    """World in which it flies, or the address at which a radio reaches it."""
    platform: Text = "paper"
    """Kind of Crazyflie."""
    yaw: Radians = 0.0
    """rad, world frame: heading at home."""
    leader: Flag = False
    """True for a leader of a formation."""
    role: Text = ""
    """Name of its [[roles]]."""
    host: Name | None = None
    """Host of its agent, a name of [hosts]."""
    options: Free = field(default_factory=dict)
    """Keys for its mission."""
    dongle: Dongle | None = None
    """Dongle that reaches it by radio.

    Without this key, it is the dongle of its radio:// uri, or 0 for udp://.
    """
    pose: PoseFrom = "mocap"
    """Source of its pose, for a drone with a radio."""
    body_offset: Offset = (0.0, 0.0, 0.0)
    """(3,) m: tracked centre relative to the drone's centre."""
    body_rotation: Angles = (0.0, 0.0, 0.0)
    """(3,) rad, roll, pitch, yaw: rotation with which the
    tracked body is mounted, see mocap/mounting.py.
    """
    parameters: Free = field(default_factory=dict)
    """Firmware parameters that are set at connection, in addition to those of [radio]."""
    battery_warning: Volts | None = None
    """V: a drone with a radio does not take off below this voltage; without it that of its platform."""
    battery_critical: Volts | None = None
    """V under load: a drone with a radio lands below this voltage; without it that of its platform."""


class DroneTable(SharedDroneTable, frozen=True, kw_only=True):
    """One [[drones]]."""

    id: Id
    """Number of the drone, unique in the swarm."""
    home: Position
    """(3,) m, world frame: place of the drone before the start."""
    name: DroneName = ""
    """Name for people, unique in the swarm, and for motion capture without `body`."""
    enabled: Flag = True
    """False: the drone is left out of the run."""
    neighbors: Ids | None = None
    """Drones that it receives from; None if the swarm file gives the graph in another way."""
    body: Body = ""
    """Name in motion capture; if empty, its `name`, else "cf" and its id."""
    calibration: CalibrationTable = CalibrationTable()
    """What flights of this drone have told; see `crazychoir calibrate`."""


class LogTable(SwarmTable, frozen=True, kw_only=True):
    """One [[logs]]: log variables that drones tell during the flight; recorded, and drawn by `crazychoir plot`."""

    variables: Variables
    """Names of the variables, as the firmware has them."""
    rate: LogRate = 10.0
    """Hz."""
    drones: Ids | None = None
    """Drones that tell them; without it all."""


class LinkTable(SwarmTable, frozen=True, kw_only=True):
    """Effects on messages between drones; a key that is left out has no effect."""

    loss: Probability | None = None
    """Probability that a message is lost."""
    burst: Burst | None = None
    """Mean number of messages that are lost in a row; without it losses are independent."""
    delay: Seconds | None = None
    """s: delay of each message."""
    jitter: Seconds | None = None
    """s: additional random delay."""
    duplicate: Probability | None = None
    """Probability that a message arrives twice."""
    reorder: Probability | None = None
    """Probability that a message is overtaken by later ones."""
    bandwidth: Bandwidth | None = None
    """bytes/s of the link."""

    def require_possible_bursts(self, key: str) -> None:
        """Raise ConfigError for bursts without a loss, or shorter than the loss demands.

        With the loss p, messages are lost 1 / (1 - p) in a row on average even if losses are
        independent, so shorter bursts are not possible.

        key: place of the burst, for the error
        """
        if self.burst is None or self.loss == 0.0:
            return
        problem = ""
        if self.loss is None:
            problem = "no loss is given"
        elif self.loss * self.burst > self.burst - 1.0:
            problem = f"too short for loss = {self.loss:g}"
        if problem:
            allowed = "a burst has 1 / (1 - loss) messages or more"
            do = "Correct loss (0 for none), or remove burst."
            raise ConfigError(key, self.burst, allowed, do, problem)


class EdgeTable(LinkTable, frozen=True, kw_only=True):
    """One [[network.edges]]: effects on messages from `source` to `destination`, instead of those of [network].

    With one of the two keys alone, the effects apply to all messages to and from that drone.
    """

    source: Id | None = None
    """Sender."""
    destination: Id | None = None
    """Receiver."""


class PartitionTable(SwarmTable, frozen=True, kw_only=True):
    """One [[network.partitions]]: groups that do not receive each other for a time."""

    at: Seconds
    """s since GO: begin of the partition."""
    groups: Groups
    """Groups of drones; all drones that are not listed form one more group."""
    until: Seconds | None = None
    """s since GO: end of the partition; without it there is no end."""


class FenceTable(SwarmTable, frozen=True, kw_only=True):
    """[fence]: the box, in the world frame, that no drone may leave."""

    min: Position = (-4.0, -4.0, 0.0)
    """(3,) m: lowest corner."""
    max: Position = (4.0, 4.0, 3.0)
    """(3,) m: highest corner."""


class KeepOutTable(SwarmTable, frozen=True, kw_only=True):
    """[keep_out]: the limit area, in the world frame.

    The motors of a drone outside it stop at once.

    Without it the limit area is 0.5 m larger than the fence on each side.
    """

    min: Position | None = None
    """(3,) m: lowest corner."""
    max: Position | None = None
    """(3,) m: highest corner."""


class FlightTable(SwarmTable, frozen=True, kw_only=True):
    """[flight]: the floor, the limits of references, and the operator."""

    ground: Level = 0.0
    """m, world frame: height of the floor."""
    takeoff_height: Height = 1.0
    """m above the floor."""
    speed_limit: Speed = 1.0
    """m/s: limit of references."""
    acceleration_limit: Acceleration = 2.0
    """m/s2: limit of references."""
    landing_speed: Speed = 0.3
    """m/s: speed of descent."""
    operator: Flag = False
    """True if drones wait for an operator's take-off, and missions for the operator's start."""
    dead_man: Seconds = 0.0
    """Seconds without the operator's console after which all drones land; 0 for never."""


class MocapTable(SwarmTable, frozen=True, kw_only=True):
    """[mocap]: the cameras, simulated or real.

    The keys from rate to tilt_spread describe simulated cameras. All other keys
    describe the cameras of drones with a radio.
    """

    rate: Hertz = 100.0
    """Hz: poses a second."""
    noise: Metres = 0.0001
    """m: standard deviation of the position, for each axis."""
    noise_angle: Turn = 0.00175
    """rad: standard deviation of the attitude, for each axis."""
    dropout: Probability = 0.0
    """Probability that a pose is missing."""
    latency: Seconds = 0.0
    """s: age of a pose when it arrives, in whole periods of the rate."""
    tilt: Tilt = (0.0, 0.0)
    """(2,) rad, roll, pitch: angles by which the tracked body is mounted askew on the drone."""
    tilt_spread: Turn = 0.005
    """rad: standard deviation of such angles that differ from drone to drone."""
    source: Source = "virtual"
    """Motion capture system."""
    hostname: Text = "127.0.0.1"
    """Address of the system."""
    port: UdpPort = 19849
    """UDP port, for the source "virtual"."""
    file: Text = ""
    """Recording (CSV) for the source "replay", relative to the swarm file."""
    options: Free = field(default_factory=dict)
    """More arguments for motioncapture's connect."""
    connect_deadline: Timeout = 5.0
    """s: time in which the system must answer."""
    host: Name | None = None
    """Host on which crazychoir-mocap runs."""


class DongleTable(SwarmTable, frozen=True, kw_only=True):
    """One [[radio.dongles]]: a dongle, the host of its process, and its capacity."""

    dongle: Dongle
    """Number of the dongle in the swarm."""
    host: Name | None = None
    """Host to which the dongle is plugged."""
    capacity: Packets | None = None
    """Packets a second; without it the capacity of [radio]."""
    inline: Flag | None = None
    """As in [radio], for this dongle."""


Dongles = Annotated[
    tuple[DongleTable, ...],
    Meta(
        description="a list of tables [[radio.dongles]]",
        examples=[[{"dongle": 0, "host": "laptop"}]],
    ),
]


class RadioTable(SwarmTable, frozen=True, kw_only=True):
    """[radio]: the connection to drones with a uri udp:// or radio://."""

    capacity: Packets | None = None
    """Packets a second of a dongle, if each goes to another drone than the last; without it 250, or
    1250 with inline.
    """
    inline: Flag = False
    """True for a Crazyradio 2.0 with firmware 5.1 or newer: it changes from drone to drone at once."""
    broadcast: Flag | None = None
    """True: one packet carries the poses of two drones, to all drones of a dongle. False: each drone
    is sent its own. Without it the way that needs less time.
    """
    command_rate: Rate = 0.0
    """Hz of set-points; 0: as many as the dongles carry, but at most one command for each pose."""
    pose_rate: PoseRate = 10.0
    """Hz of the poses that are sent to a drone."""
    log_rate: Hertz = 10.0
    """Hz of the log packets that a drone sends."""
    connect_deadline: Timeout = 10.0
    """s: time to connect to one drone."""
    watchdog: Flag = False
    """True: a drone with the sender "xyz" cuts its motors 1 s after its radio fails. It stays
    locked until it is restarted, also after the end of a run. False: it flies on.
    """
    thrust_map: ThrustMap | None = None
    """Thrust command a newton for all drones, for firmware of an unknown release."""
    parameters: Free = field(default_factory=dict)
    """Firmware parameters of all drones."""
    origin: Position = (0.0, 0.0, 0.0)
    """(3,) m, world frame: origin of the frame in which drones
    estimate their own pose (pose = "onboard").
    """
    origin_yaw: Radians = 0.0
    """rad, world frame: heading of that frame."""
    drift: Flag = False
    """True if a mission that needs a common frame may fly with such poses."""
    dongles: Dongles = ()
    """Hosts and capacities of the dongles."""


class PlantTable(SwarmTable, frozen=True, kw_only=True):
    """[plant]: the properties of a simulated drone.

    inputs and rate_lag are for the lightweight world only, all other keys for every world.
    """

    inputs: Inputs = "rates"
    """Command that steers the drone: body rates or Euler rates."""
    rate_lag: Seconds = 0.03
    """s: time constant of the body rates."""
    command_delay: Seconds = 0.02
    """s: time until the drone obeys a command."""
    mass_error: Mismatch = 0.0
    """Share by which the drone is heavier than the platform
    for which its controllers are designed.
    """
    thrust_error: Mismatch = 0.0
    """Share by which its thrust is larger than that of the platform."""


class MotorsTable(SwarmTable, frozen=True, kw_only=True):
    """[motors]: the motor-level world."""

    wind: Wind = (0.0, 0.0, 0.0)
    """(3,) m/s, world frame: mean wind."""
    gusts: Gust = 0.0
    """m/s: standard deviation of the gusts, for each axis."""
    gust_time: Timeout = 2.0
    """s: duration of a gust."""
    ground_effect: Flag = True
    """True to simulate the ground effect."""
    downwash: Flag = True
    """True to simulate the downwash."""
    battery: Share = 1.0
    """Charge at the start; 1 is full."""
    imu_noise: Factor = 1.0
    """Factor on the noise of the inertial sensors; 1 is the data sheet's."""
    floor_tilt: Tilt = (0.0, 0.0)
    """(2,) rad, roll, pitch about the world's axes: tilt of the floor below each drone."""
    imperfections: Factor = 1.0
    """Factor on all keys below but worn_battery: 1 for a typical drone, 0 for a perfect one."""
    speed_moment: SpeedMoment = 34.0
    """rad/s2 per m/s: angular acceleration that speed makes, see simulation/README.md.

    Controllers cancel it, for real drones too, unless [drones.calibration] says another one.
    """
    rate_damping: Damping = 3.0
    """1/s: damping of the roll and pitch rates."""
    imbalance: Imbalance = 0.1
    """Largest share by which the thrust of a motor differs from that of the platform."""
    torque_disturbance: AngularAcceleration = 3.0
    """rad/s2: standard deviation of slow random torques about x and y; a third of it about z."""
    force_disturbance: Unrest = 0.07
    """m/s2: standard deviation of slow random forces, for each axis."""
    disturbance_time: Timeout = 0.5
    """s: time constant of both."""
    vibration: Factor = 1.0
    """Factor on the noise of the inertial sensors that flying adds."""
    pose_latency: Seconds = 0.03
    """s: mean age of a pose when the estimator on board takes it."""
    pose_jitter: Seconds = 0.01
    """s: largest difference of that age from its mean."""
    worn_battery: Flag = False
    """True for a battery that sags by 0.6 V and is empty after two minutes."""


class MujocoTable(SwarmTable, frozen=True, kw_only=True):
    """[mujoco]: the drone's shape and the scene of mujoco:// worlds, which also use [motors].

    Paths are relative to the swarm file.
    """

    model: Text = ""
    """File with a drone's shape (STL, OBJ, URDF, MJCF); empty for the built-in shape."""
    body: Text = ""
    """Body of the drone in that file, if there are several."""
    scale: Scale = 1.0
    """Factor on its lengths; 0.001 for millimetres."""
    scene: Text = ""
    """MJCF file with the objects in the room."""


class WorldTable(SwarmTable, frozen=True, kw_only=True):
    """[world]: the process that owns the simulated world in real time."""

    owned: Flag = False
    """True to move lightweight drones, too, to that process.

    Otherwise they are simulated in their agents.
    """
    host: Name | None = None
    """Host on which it runs."""
    options: Free = field(default_factory=dict)
    """Keys for a simulation engine of another package."""


class CollisionTable(SwarmTable, frozen=True, kw_only=True):
    """[collision]: collision avoidance."""

    method: Avoidance = "barrier"
    """"off", "barrier" (two drones together can always stop) or "cells"
    (each drone can stop on its side of the middle).
    """
    semi_axes: SemiAxes = (0.12, 0.12, 0.3)
    """(3,) m: semi-axes of the ellipsoid around each drone.

    Ellipsoids must not meet. They are tall because of the downwash.
    """
    margin: Metres = 0.08
    """m: distance kept in addition to twice the first semi-axis."""
    slack: Metres = 0.02
    """m: additional distance between drones on agreed paths
    (with the sender "xyz", "vel" or "fullstate").
    """
    brake: Acceleration = 1.0
    """m/s2: deceleration that a drone relies on."""
    gamma: ClosingRate = 4.0
    """1/s: rate at which the limit of the closing speed is approached."""
    turn: Factor = 1.0
    """Strength of the sideways motion of a drone with another drone in its way."""
    range: Distance = 2.0
    """m: distance within which other drones count."""
    unsure: AccelerationChange = 2.0
    """m/s2: assumed change of acceleration of a drone that is not received."""
    lag: Seconds = 0.05
    """s: time constant with which drones obey."""
    delay: Seconds = 0.05
    """s: dead time with which drones obey."""
    stiff: ClosingRate = 1.5
    """1/s: largest relative rate at which a gap closes."""


class ControlTable(SwarmTable, frozen=True, kw_only=True):
    """[control]: the controller and the commands of a drone."""

    sender: Sender | None = None
    """Kind of command; without it "fpqr", or "frpy" for a drone with a radio."""
    gains: Free = field(default_factory=dict)
    """Gains of the tracking controller, instead of the standard ones."""
    position_rate: Rate = 0.0
    """Hz of the position controller; 0: each tick."""
    filter: Filter = "kalman"
    """Filter that computes velocities from poses."""


class RoleTable(ControlTable, frozen=True, kw_only=True):
    """One [[roles]]: a separate [control] for the drones with this `role`."""

    name: Text
    """Name of the role."""


Roles = Annotated[
    tuple[RoleTable, ...],
    Meta(
        description="a list of tables [[roles]]",
        examples=[[{"name": "scout", "sender": "frpy"}]],
    ),
]
Drones = Annotated[
    tuple[DroneTable, ...],
    Meta(
        description="a list of drones: one table [[drones]] each",
        examples=[[{"id": 0, "home": [0.0, 0.6, 0.0]}]],
    ),
]
Logs = Annotated[
    tuple[LogTable, ...],
    Meta(
        description="a list of tables [[logs]]",
        examples=[[{"variables": ["pm.vbat"], "rate": 1}]],
    ),
]
LinkEdges = Annotated[
    tuple[EdgeTable, ...],
    Meta(
        description="a list of tables [[network.edges]]",
        examples=[[{"source": 0, "destination": 1, "loss": 0.1}]],
    ),
]
Partitions = Annotated[
    tuple[PartitionTable, ...],
    Meta(
        description="a list of tables [[network.partitions]]",
        examples=[[{"at": 5.0, "groups": [[0, 1]]}]],
    ),
]


class NetworkTable(LinkTable, frozen=True, kw_only=True):
    """[network]: a simulated bad network between the drones.

    A key that is left out has no effect.
    """

    edges: LinkEdges = ()
    """Rules for single edges."""
    partitions: Partitions = ()
    """Groups of drones that do not receive each other for a time."""


class SecurityTable(SwarmTable, frozen=True, kw_only=True):
    """[security]: encryption and access control of the network between hosts.

    By default the network is encrypted and closed as soon as one host is not this machine.
    """

    insecure: Flag | None = None
    """True: never encrypted or closed. False: encrypted and closed on this machine, too."""
    keys: Text = "keys"
    """Folder of `crazychoir keys`, relative to the swarm file."""
    operators: Names = ()
    """Names of certificates; their hosts may command the swarm."""


BASE_PORT = 7460  # the port if the swarm file has none


class Swarm(SwarmTable, frozen=True, kw_only=True):
    """The keys of a swarm file, in SI units and the world frame; see deploy/README.md."""

    name: Name
    """Name of the swarm."""
    drones: Drones
    """The drones of the swarm."""
    defaults: SharedDroneTable = SharedDroneTable()
    """Values for all drones."""
    left_out: Ids = ()
    """Drones that are left out of the run, beside those with enabled = false."""
    mission: Mission | None = None
    """Mission to fly: a file in agents/, or the path of a .py file."""
    mission_options: Free = field(default_factory=dict)
    """Keys for the mission."""
    seed: Seed = 0
    """Seed of all random draws."""
    graph_name: Text | None = field(default=None, name="graph")
    """Name of the communication graph; its key in the file is `graph`."""
    edges: Edges | None = None
    """Edges of the graph, instead of its name."""
    directed: Flag = False
    """True if the graph is directed."""
    start: Start = "all"
    """"all", or the number of drones that suffice at the start deadline."""
    start_deadline: Timeout = 30.0
    """s: time to wait for the team."""
    lost_after: Timeout = 5.0
    """s without a message after which a drone is lost."""
    lease: Timeout = 1.0
    """s without a sign of a host before it counts as gone from the network."""
    base_port: Port = BASE_PORT
    """A process listens on this port plus its lowest drone id."""
    processes: Groups | None = None
    """Groups of drones that share a process; without it each drone has its own."""
    hosts: Hosts = field(default_factory=dict)
    """Address of each host, by name."""
    router: Name | None = None
    """Host of the router; without it processes connect to each other directly."""
    security: SecurityTable = SecurityTable()
    """Encryption and access control."""
    network: NetworkTable = NetworkTable()
    """Simulated bad network."""
    flight: FlightTable = FlightTable()
    """Floor, limits of references, and operator."""
    fence: FenceTable = FenceTable()
    """Box that no drone may leave."""
    keep_out: KeepOutTable = KeepOutTable()
    """Limit area around the fence."""
    mocap: MocapTable = MocapTable()
    """Cameras."""
    radio: RadioTable = RadioTable()
    """Connection to real and virtual Crazyflies."""
    plant: PlantTable = PlantTable()
    """Properties of simulated drones."""
    motors: MotorsTable = MotorsTable()
    """Motor-level world."""
    mujoco: MujocoTable = MujocoTable()
    """Shapes in mujoco://."""
    world: WorldTable = WorldTable()
    """Process that owns the simulated world."""
    collision: CollisionTable = CollisionTable()
    """Collision avoidance."""
    control: ControlTable = ControlTable()
    """Controller and commands of drones without a role."""
    roles: Roles = ()
    """Controllers of drones with a role."""
    logs: Logs = ()
    """Log variables of drones that are recorded."""


HOST_KEYS = ("hosts", "router", "security", "base_port", "network")
"""Keys that may differ between hosts: the ways to reach each other, and the simulated network."""
AGREED_KEYS = tuple(
    key for key in Swarm.__struct_encode_fields__ if key not in HOST_KEYS
)
"""All other keys of a swarm file: they must be equal at all hosts."""
BODY_KEYS = (
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
"""Keys that must be equal at the agents and at the processes that own bodies or cameras.

These processes do not know the mission.
"""
