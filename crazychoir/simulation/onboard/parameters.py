"""The parameters of the firmware by name, with their places in a drone's record."""

import difflib

from crazychoir.errors import ConfigError
from crazychoir.simulation.onboard.record import (
    BRESCIANINI_DEFAULTS,
    INDI_DEFAULTS,
    INDI_POSITION_DEFAULTS,
    LEE_DEFAULTS,
    MELLINGER_DEFAULTS,
)

ParameterPlace = tuple[str, ...]


def _place_gains(
    group: str, names: dict[str, str], gains: str
) -> dict[str, ParameterPlace]:
    """Return the places of the four gains of each PID, by parameter name.

    group: group of the parameters
    names: {prefix of a parameter: PID}
    gains: the group's names for kp, ki, kd and kff
    """
    fields = tuple(zip(gains.split(), ("kp", "ki", "kd", "kff"), strict=True))
    return {
        f"{group}.{prefix}{gain}": (f"{pid}_pid", field)
        for prefix, pid in names.items()
        for gain, field in fields
    }


AVOIDANCE_NAMES = {
    **{f"ellipsoid{axis.upper()}": f"radius_{axis}" for axis in "xyz"},
    **{f"bboxMin{axis.upper()}": f"box_min_{axis}" for axis in "xyz"},
    **{f"bboxMax{axis.upper()}": f"box_max_{axis}" for axis in "xyz"},
    "horizon": "horizon",
    "maxSpeed": "speed",
    "sidestepThrsh": "sidestep",
    "maxPeerLocAge": "peer_age",
    "vorTol": "tolerance",
    "vorIters": "passes",
}
"""Fields of the parameters of the group colAv."""
HEIGHT_NAMES = {
    "estAlphaAsl": "height_share",
    "velFactor": "speed_factor",
    "velZAlpha": "speed_share",
    "vAccDeadband": "dead_band",
}
"""Fields of the parameters of the group posEstAlt."""
HEALTH_NAMES = {
    "propTestThreshold": "most",
    "propTestThresholdL": "least",
    "propTestPWMRatio": "propeller_ratio",
    "batTestPWMRatio": "battery_ratio",
}
"""Fields of the parameters of the group health that do not start a test."""
PARAMETER_PLACES: dict[str, ParameterPlace] = {
    **_place_gains(
        "pid_rate",
        {"roll_": "roll_rate", "pitch_": "pitch_rate", "yaw_": "yaw_rate"},
        "kp ki kd kff",
    ),
    **_place_gains(
        "pid_attitude",
        {"roll_": "roll", "pitch_": "pitch", "yaw_": "yaw"},
        "kp ki kd kff",
    ),
    "pid_attitude.yawMaxDelta": ("yaw_max_delta",),
    **_place_gains(
        "velCtlPid", {axis: axis for axis in ("vx", "vy", "vz")}, "Kp Ki Kd KFF"
    ),
    **_place_gains("posCtlPid", {axis: axis for axis in "xyz"}, "Kp Ki Kd Kff"),
    "posCtlPid.xVelMax": ("x_vel_max",),
    "posCtlPid.yVelMax": ("y_vel_max",),
    "posCtlPid.zVelMax": ("z_vel_max",),
    "posCtlPid.rLimit": ("roll_limit",),
    "posCtlPid.pLimit": ("pitch_limit",),
    "posCtlPid.thrustBase": ("thrust_base",),
    "posCtlPid.thrustMin": ("thrust_minimum",),
    **{
        f"ctrlMel.{name}": ("mellinger", name) for name in ("mass", *MELLINGER_DEFAULTS)
    },
    **{
        f"ctrlLee.{name}": ("lee", name)
        for name in ("mass", *LEE_DEFAULTS, "Kpos_Ix", "Kpos_Iy", "Kpos_Iz")
    },
    **{f"ctrlAtt.{name}": ("brescianini", name) for name in BRESCIANINI_DEFAULTS},
    **{f"ctrlINDI.{name}": ("indi", name) for name in INDI_DEFAULTS},
    "ctrlINDI.outerLoopActive": ("indi", "outer_loop"),
    **{f"posCtrlIndi.{name}": ("indi", name) for name in INDI_POSITION_DEFAULTS},
    "colAv.enable": ("avoids",),
    **{
        f"colAv.{name}": ("avoidance", field) for name, field in AVOIDANCE_NAMES.items()
    },
    "flightmode.stabModeRoll": ("rate_roll_mode",),
    "flightmode.stabModePitch": ("rate_pitch_mode",),
    "flightmode.stabModeYaw": ("rate_yaw_mode",),
    "flightmode.althold": ("holds_height",),
    "flightmode.poshold": ("holds_position",),
    "flightmode.posSet": ("sets_position",),
    "flightmode.yawMode": ("yaw_mode",),
    "health.startPropTest": ("start_propellers",),
    "health.startBatTest": ("start_battery",),
    **{f"health.{name}": ("health", field) for name, field in HEALTH_NAMES.items()},
    "hlCommander.vtoff": ("planner", "take_off_speed"),
    "hlCommander.vland": ("planner", "landing_speed"),
    "kalman.initialX": ("initial_x",),
    "kalman.initialY": ("initial_y",),
    "kalman.initialZ": ("initial_z",),
    "kalman.initialYaw": ("initial_yaw",),
    "kalman.maxPos": ("max_pos",),
    "kalman.maxVel": ("max_vel",),
    "kalman.pNAcc_xy": ("noise_xy",),
    "kalman.pNAcc_z": ("noise_z",),
    "kalman.pNPos": ("noise_position",),
    "kalman.pNVel": ("noise_velocity",),
    "kalman.pNAtt": ("noise_attitude",),
    "kalman.mNGyro_rollpitch": ("noise_gyro",),
    "kalman.mNGyro_yaw": ("noise_gyro_yaw",),
    "locSrv.extPosStdDev": ("ext_pos_std",),
    "locSrv.extQuatStdDev": ("ext_quat_std",),
    "motorPowerSet.enable": ("power_set",),
    **{f"motorPowerSet.m{k}": (f"power_{k}",) for k in (1, 2, 3, 4)},
    "powerDist.idleThrust": ("idle",),
    **{
        f"posEstAlt.{name}": ("complementary", field)
        for name, field in HEIGHT_NAMES.items()
    },
    "sensfusion6.kp": ("complementary", "kp"),
    "sensfusion6.ki": ("complementary", "ki"),
    "sensfusion6.baseZacc": ("complementary", "base_force"),
    "stabilizer.controller": ("controller",),
    "stabilizer.estimator": ("estimator",),
    "stabilizer.stop": ("estop",),
    "supervisor.prefltTimeout": ("preflight_timeout",),
    "supervisor.landedTimeout": ("landed_timeout",),
    "supervisor.spinupTimeout": ("spinup_timeout",),
    "supervisor.tmblChckEn": ("tumble_check",),
    "supervisor.crashDetectGs": ("crash_deviation",),
}
RESET_ESTIMATION = "kalman.resetEstimation"
"""A parameter without a place: writing 1 resets the estimator."""


def find_parameter(name: str) -> ParameterPlace:
    """Return the place of a parameter.

    Raises ConfigError with the nearest names if there is no such parameter.
    """
    if name in PARAMETER_PLACES:
        return PARAMETER_PLACES[name]
    near = (
        difflib.get_close_matches(name, [*PARAMETER_PLACES, RESET_ESTIMATION], n=3)
        or sorted(PARAMETER_PLACES)[:3]
    )
    raise ConfigError(
        "firmware parameter",
        name,
        f"the {len(PARAMETER_PLACES) + 1} that are simulated, such as {', '.join(near)}",
    )
