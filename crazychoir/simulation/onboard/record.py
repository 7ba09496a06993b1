"""The memory of the firmware: one record a drone, all drones of a process in one array."""

import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.firmware.memories import TRAJECTORY_MEMORY
from crazychoir.firmware.timeouts import FIRMWARE_TIMEOUTS
from crazychoir.platforms import Platform

Record = Any
"""The row of one drone: a numpy record in Python, a numba record in a kernel."""
Fleet = npt.NDArray[np.void]


class AxisModes(NamedTuple):
    """Modes of one axis of a set-point."""

    disabled: int = 0
    """The axis is not controlled."""
    absolute: int = 1
    """The set-point is a value."""
    velocity: int = 2
    """The set-point is a rate."""


AXIS_MODES = AxisModes()


class YawModes(NamedTuple):
    """Values of the parameter flightmode.yawMode."""

    carefree: int = 0
    """Not implemented in the firmware: an assertion fails."""
    plus: int = 1
    """Motor 1 is in front."""
    cross: int = 2
    """Motors 1 and 4 are in front."""


YAW_MODES = YawModes()


class ControllerKinds(NamedTuple):
    """Values of the parameter stabilizer.controller."""

    pid: int = 1
    """The cascade of PIDs."""
    mellinger: int = 2
    """Mellinger's controller."""
    indi: int = 3
    """Incremental nonlinear dynamic inversion."""
    brescianini: int = 4
    """Brescianini's controller."""
    lee: int = 5
    """Lee's controller."""
    out_of_tree: int = 6
    """A user's law."""


CONTROLLER_KINDS = ControllerKinds()


class EstimatorKinds(NamedTuple):
    """Values of the parameter stabilizer.estimator."""

    complementary: int = 1
    """The complementary filter."""
    kalman: int = 2
    """The extended Kalman filter."""


ESTIMATOR_KINDS = EstimatorKinds()


class OutputKinds(NamedTuple):
    """Kinds of output of a controller."""

    legacy: int = 0
    """Thrust, roll, pitch, yaw."""
    force_torque: int = 1
    """Force and torques in SI units."""
    motors: int = 2
    """Four thrusts."""


OUTPUT_KINDS = OutputKinds()


EXPANDED_PIECES = 64
"""Pieces behind the memory for trajectories: a compressed trajectory after its expansion; chosen."""


class AvoidanceMemory(NamedTuple):
    """Sizes of the memory for the avoidance of collisions."""

    peer_count: int = 10
    """Other drones with a position that the firmware remembers."""
    face_count: int = 16
    """Faces of the cell: one a peer, and six of the box."""


AVOIDANCE_MEMORY = AvoidanceMemory()


def _real_fields(names: str) -> list[tuple[str, type]]:
    return [(name, np.float64) for name in names.split()]


def _integer_fields(names: str) -> list[tuple[str, type]]:
    return [(name, np.int64) for name in names.split()]


pid_fields = np.dtype(
    _real_fields("kp ki kd kff i_limit limit integral previous d1 d2 desired slope")
)
"""Fields of a PID: gains; limits of the integral and of the output (0: none); memory.

desired and slope (of the measurement) are those of the last pass, for log variables.
"""

setpoint_fields = np.dtype(
    [
        *_integer_fields(
            "mode_x mode_y mode_z mode_roll mode_pitch mode_yaw mode_quat body_velocity"
        ),
        *_real_fields(
            "x y z vx vy vz ax ay az jx jy jz roll pitch yaw roll_rate pitch_rate yaw_rate thrust qx qy qz qw"
        ),
    ]
)
"""Fields of a set-point, in the firmware's units: m, m/s, m/s2, m/s3, deg, deg/s, thrust 0..65535.

pitch is positive nose up. The rates of a full state and of the planner are those of the body,
forward-left-up.
"""

planner_fields = np.dtype(
    [
        ("state", np.int64),
        # slot of the flown trajectory; -1: the one piece of a take-off, landing or go_to
        ("slot", np.int64),
        ("reversed", np.int64),
        ("begin", np.float32),  # s
        ("timescale", np.float32),
        # start of a relative trajectory by its coefficients, m, rad
        ("origin", np.float32, (4,)),
        ("shift", np.float32, (4,)),  # its start in this flight
        ("piece", np.float32, (TRAJECTORY_MEMORY.piece_size,)),
        # p, yaw, v, yaw', a, yaw'', j, yaw''' of the last evaluation
        ("out", np.float32, (16,)),
        # p, yaw of the last set-point, or of the state while idle
        ("last", np.float32, (4,)),
        ("last_v", np.float32, (4,)),
        (
            "offset",
            np.int64,
            (TRAJECTORY_MEMORY.slot_count,),
        ),  # float32 from the start of the memory
        ("pieces", np.int64, (TRAJECTORY_MEMORY.slot_count,)),  # 0: not defined
        # first byte and segments of a compressed trajectory; 0 segments: not compressed
        ("packed", np.int64, (TRAJECTORY_MEMORY.slot_count, 2)),
        ("take_off_speed", np.float64),
        ("landing_speed", np.float64),
    ],
    align=True,
)

mellinger_fields = np.dtype(
    _real_fields(
        "mass massThrust kp_xy kd_xy ki_xy i_range_xy kp_z kd_z ki_z i_range_z kR_xy kw_xy ki_m_xy i_range_m_xy "
        "kR_z kw_z ki_m_z i_range_m_z kd_omega_rp ix iy iz imx imy imz wx wy wx_set wy_set "
        "zdx zdy zdz"
    )
)
"""Fields of Mellinger's controller: parameters; integrals and rates of the last pass; wanted z_b."""
lee_fields = np.dtype(
    _real_fields(
        "mass J_x J_y J_z Kpos_Px Kpos_Py Kpos_Pz Kpos_P_limit Kpos_Dx Kpos_Dy Kpos_Dz Kpos_D_limit Kpos_Ix Kpos_Iy "
        "Kpos_Iz Kpos_I_limit KR_x KR_y KR_z Kw_x Kw_y Kw_z KI_x KI_y KI_z ix iy iz irx iry irz "
        "ahead_x ahead_y ahead_z left_z up_z wdx wdy wdz"
    )
)
"""Fields of Lee's controller: parameters; integrals; what the log variables need of the last pass.

ahead, left and up are x, y and z of the wanted body axes; wd is the wanted rate in body axes, rad/s.
"""

indi_fields = np.dtype(
    [
        *_real_fields(
            "thrust_threshold bound_ctrl_input g1_p g1_q g1_r g2 ref_err_p ref_err_q ref_err_r "
            "ref_rate_p ref_rate_q ref_rate_r act_dyn_p act_dyn_q act_dyn_r filt_cutoff filt_cutoff_r "
            "K_xi_x K_xi_y K_xi_z K_dxi_x K_dxi_y K_dxi_z pq_clamping"
        ),
        ("outer_loop", np.int64),  # 0: the PIDs take its place
        # low-pass filters: b0, a1, a2 of roll and pitch, yaw, outer loop; two delays of each
        ("filters", np.float64, (3, 3)),
        ("delays", np.float64, (13, 2)),
        # filtered rates of the last pass, rad/s; commands; what the rotors have reached of them
        *_real_fields("rate_p rate_q rate_r u_p u_q u_r reached_p reached_q reached_r"),
        ("du_r", np.float64),  # last increment of the yaw command
        # rad, and thrust commands
        *_real_fields("wanted_roll wanted_pitch wanted_yaw"),
        *_real_fields("outer_roll outer_pitch outer_thrust reached_thrust"),
    ],
    align=True,
)
"""Fields of INDI: parameters; memory. Axes are forward-right-down."""
brescianini_fields = np.dtype(
    _real_fields(
        "tau_xy zeta_xy tau_z zeta_z tau_rp mixing_factor coll_fairness mass wx wy wz lift"
    )
)
"""Fields of Brescianini's controller: parameters; wanted rates rad/s and thrust for the mass m/s2."""

complementary_fields = np.dtype(
    [
        # gains; specific force at rest, g; share of the height and of the speed that stays
        *_real_fields(
            "kp ki base_force height_share speed_share speed_factor dead_band"
        ),
        ("calibrated", np.int64),
        *_real_fields("bias_x bias_y bias_z"),  # rad/s
        *_real_fields("qx qy qz qw gravity_x gravity_y gravity_z"),
        *_real_fields("speed height climb"),  # m/s, m above the sea, m/s
    ],
    align=True,
)
"""Fields of the complementary estimator: parameters; memory."""

health_fields = np.dtype(
    [
        # ms: how long a motor turns in the test of the propellers, how long it rests, first sample
        *_integer_fields("on_ticks off_ticks sample_start"),
        # PWM ratios of the platform for the two tests
        *_real_fields("usual_propeller_ratio usual_battery_ratio"),
        # PWM ratios of the parameters; above 0 they are used instead
        *_real_fields("propeller_ratio battery_ratio"),
        # g2: range of the variance that a good propeller makes
        *_real_fields("least most"),
        # ms since the test, or the turn of its motor, began
        *_integer_fields("tick"),
        # number of the motor that turns, from 0
        *_integer_fields("motor"),
        # sums of the accelerometer's samples, g, and of their squares, g2
        *_real_fields("sum_x sum_y square_x square_y"),
        # V before the test, and least voltage in it
        *_real_fields("idle_voltage least_voltage"),
        # results: bits of the motors, number of tests, g2 of each motor; V
        *_integer_fields("passed count battery_passed"),
        ("variance_x", np.float64, (4,)),
        ("variance_y", np.float64, (4,)),
        ("sag", np.float64),
    ],
    align=True,
)
"""Fields of the health tests: figures of the platform, parameters, memory, results."""

avoidance_fields = np.dtype(
    [
        # m: half of the least distance from a peer; corners of the flight area
        *_real_fields("radius_x radius_y radius_z"),
        *_real_fields("box_min_x box_min_y box_min_z box_max_x box_max_y box_max_z"),
        # s, m/s, m: horizon, largest speed, distance from a wall at which the drone steps aside
        *_real_fields("horizon speed sidestep"),
        ("peer_age", np.int64),  # ms after which a position is ignored; below 0: never
        ("tolerance", np.float64),  # m, of the projection
        ("passes", np.int64),  # greatest number of passes of the projection
        *_real_fields(
            "kept_x kept_y kept_z"
        ),  # last place that was in the cell, or NaN
        # the other drones: last bytes of their addresses, 0 without one; m; ms
        ("peers", np.int64, (AVOIDANCE_MEMORY.peer_count,)),
        ("positions", np.float64, (AVOIDANCE_MEMORY.peer_count, 3)),
        ("heard_at", np.int64, (AVOIDANCE_MEMORY.peer_count,)),
        # the cell of the last pass, and the memory of the projection
        ("faces", np.int64),
        ("normals", np.float64, (AVOIDANCE_MEMORY.face_count, 3)),
        ("bounds", np.float64, (AVOIDANCE_MEMORY.face_count,)),
        ("corrections", np.float64, (AVOIDANCE_MEMORY.face_count, 3)),
    ],
    align=True,
)
"""Fields of the avoidance of collisions: parameters, other drones, cell."""

PID_NAMES = "roll_rate pitch_rate yaw_rate roll pitch yaw vx vy vz x y z"
"""PIDs of controller 1: rates, attitude, velocity and position."""

drone_fields = np.dtype(
    [
        ("tick", np.int64),  # ms
        # health.startPropTest, .startBatTest, and the state of the test
        *_integer_fields("start_propellers start_battery test_state"),
        # written and read by the simulation
        # shares of firmware.thrust_max that the motors give, above 1 as well
        ("motors", np.float64, (4,)),
        ("vbat", np.float64),  # V
        # sensors
        ("delays", np.float64, (12,)),  # memory of the low-pass filters
        *_real_fields("gx gy gz ax ay az"),  # filtered: deg/s, g
        # sum in m/s2 and count of the samples at rest; scale that makes their mean 1 g
        *_real_fields("acc_sum acc_count acc_scale"),
        (
            "asl",
            np.float64,
        ),  # m above the sea, by the barometer; written by the simulation
        # estimator
        ("estimator", np.int64),
        *_real_fields("p_sum q_sum r_sum fx_sum fy_sum fz_sum"),
        ("samples", np.int64),
        *_real_fields("x y z vx vy vz qx qy qz qw acx acy acz roll pitch yaw"),
        *_real_fields("xy_pp xy_pv xy_vv xy_pt xy_vt xy_tt z_pp z_pv z_vv yaw_var"),
        *_real_fields(
            "ext_pos_std ext_quat_std noise_xy noise_z noise_gyro max_pos max_vel"
        ),
        *_real_fields("noise_position noise_velocity noise_attitude noise_gyro_yaw"),
        *_real_fields("initial_x initial_y initial_z initial_yaw"),
        ("resets", np.int64),
        # commander
        ("priority", np.int64),
        ("stamp", np.int64),  # ms
        ("locked_thrust", np.int64),
        ("rate_roll_mode", np.int64),  # flightmode.stabMode*: 0 rate, 1 angle
        ("rate_pitch_mode", np.int64),
        ("rate_yaw_mode", np.int64),
        # flightmode.althold, .poshold, .posSet and .yawMode
        *_integer_fields("holds_height holds_position sets_position yaw_mode"),
        ("wanted", setpoint_fields),
        ("avoids", np.int64),  # colAv.enable: `avoided` is flown instead of `wanted`
        # supervisor
        *_integer_fields(
            "self_tested state since armed auto_arm turning flying falling tumbled crashed emergency estop info"
        ),
        *_integer_fields("tilted tilted_at watchdog watchdog_at stopping_at"),
        *_integer_fields(
            "preflight_timeout landed_timeout spinup_timeout tumble_check"
        ),
        ("crash_deviation", np.float64),  # supervisor.crashDetectGs, g; 0: none
        # controllers
        ("controller", np.int64),
        ("law_due", np.int64),
        ("modes", np.int64),  # modes of the last set-point that the controller followed
        *[(f"{name}_pid", pid_fields) for name in PID_NAMES.split()],
        *_real_fields("x_vel_max y_vel_max z_vel_max roll_limit pitch_limit"),
        *_real_fields("thrust_base thrust_minimum yaw_max_delta"),
        *_real_fields("target_vx target_vy target_vz position_thrust"),
        *_real_fields("target_roll target_pitch target_yaw"),
        *_real_fields("target_roll_rate target_pitch_rate target_yaw_rate"),
        # output of the controller
        ("output", np.int64),
        *_real_fields("thrust roll_out pitch_out yaw_out"),  # legacy
        *_real_fields("force torque_x torque_y torque_z"),  # N, N m
        ("law_motors", np.float64, (4,)),  # 0..65535, output of a user's law
        # power distribution
        # thrust of each motor, 65535 = thrust_max; integers without a limit
        ("request", np.float64, (4,)),
        ("volts", np.float64, (4,)),  # V of each motor for its request
        # PWM ratio of each motor for its request; integers without an upper limit
        ("uncapped_ratio", np.float64, (4,)),
        ("ratio", np.float64, (4,)),  # PWM ratio of each motor, 0..65535
        # motorPowerSet.enable: 1 sets each motor by its own power, 2 sets all motors by power_1
        ("power_set", np.int64),
        # PWM ratios, 0..65535
        *_real_fields("power_1 power_2 power_3 power_4"),
        *_real_fields(
            "vbat_low idle thrust_max thrust_min arm torque_ratio c0 c1 c2 c3"
        ),
        # Fields not needed in each ms are last, so that the others of 1000 drones fit into a cache.
        ("level", setpoint_fields),
        ("avoided", setpoint_fields),
        ("avoidance", avoidance_fields),
        ("complementary", complementary_fields),
        ("health", health_fields),
        ("planner", planner_fields),
        ("mellinger", mellinger_fields),
        ("lee", lee_fields),
        ("indi", indi_fields),
        ("brescianini", brescianini_fields),
        (
            "memory",
            np.float32,
            (TRAJECTORY_MEMORY.size + EXPANDED_PIECES * TRAJECTORY_MEMORY.piece_size,),
        ),
    ],
    align=True,
)
drone: Any = numba.from_dtype(drone_fields)
"""Type of one drone for kernels."""
rows: Any = drone[::1]
"""Type of an array of drones for kernels."""
whole: Any = numba.int64


class EntryPoints:
    """The kernels of a module that are compiled for a drone, to be called from Python.

    They are called without a check of the types of their arguments. They take the array and the
    row: passing one record of so many fields takes 60 us, this takes 0.3 us.

    module: with the kernels
    """

    def __init__(self, module: ModuleType) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        """Return the entry point of a kernel, and compile a kernel that waits for its first call."""
        law = getattr(self._module, name)
        if not hasattr(law, "signatures"):  # with NUMBA_DISABLE_JIT
            return law
        if not law.signatures:
            law.compile(())  # a kernel that waits knows its types
        entry_point = law.overloads[law.signatures[0]].entry_point
        setattr(self, name, entry_point)
        return entry_point


FLOOR_ALTITUDE = 50.0  # m above the sea, of the world's origin; chosen
LARGEST_SINGLE = float(np.finfo(np.float32).max)
"""Greatest number of 32 bits: the firmware's value for a flight area without limits."""
# Gains kp, ki, kd and limit of the integral (chosen for velocity and position) of pid_rate,
# pid_attitude, velCtlPid and posCtlPid.
CRAZYFLIE_PID_GAINS = {
    "roll_rate": (250.0, 500.0, 2.5, 33.3),
    "pitch_rate": (250.0, 500.0, 2.5, 33.3),
    "yaw_rate": (120.0, 16.7, 0.0, 166.7),
    "roll": (6.0, 3.0, 0.0, 20.0),
    "pitch": (6.0, 3.0, 0.0, 20.0),
    "yaw": (6.0, 1.0, 0.35, 360.0),
    "vx": (25.0, 1.0, 0.0, 5000.0),
    "vy": (25.0, 1.0, 0.0, 5000.0),
    "vz": (25.0, 15.0, 0.0, 5000.0),
    "x": (2.0, 0.0, 0.0, 5000.0),
    "y": (2.0, 0.0, 0.0, 5000.0),
    "z": (2.0, 0.5, 0.0, 5000.0),
}
BRUSHLESS_PID_GAINS = {
    **CRAZYFLIE_PID_GAINS,
    "roll_rate": (200.0, 400.0, 2.5, 33.3),
    "pitch_rate": (200.0, 400.0, 2.5, 33.3),
}
MELLINGER_DEFAULTS = {
    "massThrust": 132000.0,
    "kp_xy": 0.4,
    "kd_xy": 0.2,
    "ki_xy": 0.05,
    "i_range_xy": 2.0,
    "kp_z": 1.25,
    "kd_z": 0.4,
    "ki_z": 0.05,
    "i_range_z": 0.4,
    "kR_xy": 70000.0,
    "kw_xy": 20000.0,
    "ki_m_xy": 0.0,
    "i_range_m_xy": 1.0,
    "kR_z": 60000.0,
    "kw_z": 12000.0,
    "ki_m_z": 500.0,
    "i_range_m_z": 1500.0,
    "kd_omega_rp": 200.0,
}
LEE_DEFAULTS = {
    "J_x": 16.571710e-6,
    "J_y": 16.655602e-6,
    "J_z": 29.261652e-6,
    "Kpos_Px": 7.0,
    "Kpos_Py": 7.0,
    "Kpos_Pz": 7.0,
    "Kpos_P_limit": 100.0,
    "Kpos_Dx": 4.0,
    "Kpos_Dy": 4.0,
    "Kpos_Dz": 4.0,
    "Kpos_D_limit": 100.0,
    "Kpos_I_limit": 2.0,
    "KR_x": 0.007,
    "KR_y": 0.007,
    "KR_z": 0.008,
    "Kw_x": 0.00115,
    "Kw_y": 0.00115,
    "Kw_z": 0.002,
    "KI_x": 0.03,
    "KI_y": 0.03,
    "KI_z": 0.03,
}
INDI_DEFAULTS = {
    "thrust_threshold": 300.0,
    "bound_ctrl_input": 32000.0,
    "g1_p": 0.0066146,
    "g1_q": 0.0052125,
    "g1_r": 0.001497,
    "g2": 0.000043475,
    "ref_err_p": 5.0,
    "ref_err_q": 5.0,
    "ref_err_r": 5.0,
    "ref_rate_p": 24.0,
    "ref_rate_q": 24.0,
    "ref_rate_r": 24.0,
    "act_dyn_p": 0.03149,
    "act_dyn_q": 0.03149,
    "act_dyn_r": 0.03149,
    "filt_cutoff": 8.0,
    "filt_cutoff_r": 8.0,
}
INDI_POSITION_DEFAULTS = {
    "K_xi_x": 1.0,
    "K_xi_y": 1.0,
    "K_xi_z": 1.0,
    "K_dxi_x": 5.0,
    "K_dxi_y": 5.0,
    "K_dxi_z": 5.0,
    "pq_clamping": 10.0,
}
BRESCIANINI_DEFAULTS = {
    "tau_xy": 0.3,
    "zeta_xy": 0.85,
    "tau_z": 0.3,
    "zeta_z": 0.85,
    "tau_rp": 0.25,
    "mixing_factor": 1.0,
    "coll_fairness": 0.25,
}
AVOIDANCE_DEFAULTS: dict[str, float] = {
    "radius_x": 0.3,
    "radius_y": 0.3,
    "radius_z": 0.9,
    "box_min_x": -LARGEST_SINGLE,
    "box_min_y": -LARGEST_SINGLE,
    "box_min_z": -LARGEST_SINGLE,
    "box_max_x": LARGEST_SINGLE,
    "box_max_y": LARGEST_SINGLE,
    "box_max_z": LARGEST_SINGLE,
    "horizon": 1.0,
    "speed": 0.5,
    "sidestep": 0.25,
    "peer_age": 5000,
    "tolerance": 1e-5,
    "passes": 100,
    "kept_x": math.nan,
    "kept_y": math.nan,
    "kept_z": math.nan,
}
COMPLEMENTARY_DEFAULTS = {
    "kp": 0.8,
    "ki": 0.002,
    "base_force": 1.0,
    "height_share": 0.9,
    "speed_share": 0.995,
    "speed_factor": 1.0,
    "dead_band": 0.04,
    "qw": 1.0,
}
BRUSHED_HEALTH_TESTS = {
    "on_ticks": 50,
    "off_ticks": 950,
    "sample_start": 0,
    "usual_propeller_ratio": 65535.0,
    "usual_battery_ratio": 40000.0,
    "least": 0.01,
}
# Without a ratio of its own a brushless motor is not tested: a user must choose one.
BRUSHLESS_HEALTH_TESTS = {
    **BRUSHED_HEALTH_TESTS,
    "on_ticks": 2000,
    "off_ticks": 1000,
    "sample_start": 1000,
    "usual_propeller_ratio": 0.0,
    "usual_battery_ratio": 0.0,
}
PART_DEFAULTS: dict[str, dict[str, float]] = {
    "mellinger": MELLINGER_DEFAULTS,
    "lee": LEE_DEFAULTS,
    "indi": {**INDI_DEFAULTS, **INDI_POSITION_DEFAULTS, "outer_loop": 1},
    "brescianini": BRESCIANINI_DEFAULTS,
    "avoidance": AVOIDANCE_DEFAULTS,
    "complementary": COMPLEMENTARY_DEFAULTS,
}
"""Values after power-on of the fields of each part, without the mass."""
SCALAR_DEFAULTS: dict[str, float] = {
    "vbat": 4.2,
    "vbat_low": 4.2,
    "asl": FLOOR_ALTITUDE,
    "estimator": ESTIMATOR_KINDS.kalman,
    "ext_pos_std": 0.01,
    "ext_quat_std": 4.5e-3,
    "noise_xy": 0.5,
    "noise_z": 1.0,
    "noise_gyro": 0.1,
    "noise_gyro_yaw": 0.1,
    "max_pos": 100.0,
    "max_vel": 10.0,
    "locked_thrust": 1,
    "rate_roll_mode": 1,
    "rate_pitch_mode": 1,
    "rate_yaw_mode": 0,
    "yaw_mode": YAW_MODES.cross,
    "preflight_timeout": FIRMWARE_TIMEOUTS.preflight,
    "landed_timeout": FIRMWARE_TIMEOUTS.landed,
    "spinup_timeout": FIRMWARE_TIMEOUTS.spin_up,
    "tumble_check": 1,
    "controller": CONTROLLER_KINDS.pid,
    "modes": -1,
    "x_vel_max": 1.0,
    "y_vel_max": 1.0,
    "z_vel_max": 1.0,
    "roll_limit": 20.0,
    "pitch_limit": 20.0,
    "thrust_base": 36000.0,
    "thrust_minimum": 20000.0,
    "stopping_at": -10000,
    "az": 1.0,
    "acc_scale": 1.0,
    "qw": 1.0,
    "acz": 0.0,
}


def make_fleet(n: int, platform: Platform) -> Fleet:
    """Return the records of n drones of this platform, as they are after power-on."""
    rows = np.zeros(n, drone_fields)
    firmware = platform.firmware
    gains = BRUSHLESS_PID_GAINS if firmware.needs_arming else CRAZYFLIE_PID_GAINS
    for name, row in gains.items():
        pid = rows[f"{name}_pid"]
        pid["kp"], pid["ki"], pid["kd"], pid["i_limit"] = row
    rows["vz_pid"]["limit"] = 32.767  # half of 65535, by the scale of 1000
    tests = BRUSHLESS_HEALTH_TESTS if firmware.needs_arming else BRUSHED_HEALTH_TESTS
    for part, defaults in {**PART_DEFAULTS, "health": tests}.items():
        for name, value in defaults.items():
            rows[part][name] = value
    for part in ("mellinger", "lee", "brescianini"):
        rows[part]["mass"] = firmware.mass
    for name, value in SCALAR_DEFAULTS.items():
        rows[name] = value
    if firmware.needs_arming:
        rows["thrust_base"] = 30000.0
    rows["self_tested"] = 1
    rows["auto_arm"] = not firmware.needs_arming
    rows["thrust_max"] = firmware.thrust_max
    rows["thrust_min"] = firmware.thrust_min
    rows["arm"] = math.sqrt(0.5) * firmware.arm
    rows["torque_ratio"] = firmware.thrust_to_torque
    rows["c0"], rows["c1"], rows["c2"], rows["c3"] = platform.rotor.voltage
    rows["planner"]["slot"] = -1
    rows["planner"]["timescale"] = 1.0
    rows["planner"]["take_off_speed"] = rows["planner"]["landing_speed"] = 0.5
    rows["volts"] = 2.5
    for name in ("wanted", "level", "avoided"):
        rows[name]["qw"] = 1.0
    return rows


def make_mixed_fleet(platforms: Sequence[Platform]) -> Fleet:
    """Return the records of drones with these platforms, as they are after power-on."""
    # np.concatenate would give the array a dtype of its own. Numba compares unknown dtypes field by
    # field in each call of a kernel, which takes 0.1 ms for so many fields.
    fleet = np.zeros(len(platforms), drone_fields)
    for row, platform in enumerate(platforms):
        fleet[row] = make_fleet(1, platform)[0]
    return fleet
