"""Parameters, logs, controllers of the user's own, and what wrong names are told."""

import math
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from rigid_body import Body

from crazychoir.errors import ConfigError
from crazychoir.platforms import CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS
from crazychoir.simulation.onboard import logs, loop, parameters
from crazychoir.simulation.onboard.cffirmware import FirmwareLaw
from crazychoir.simulation.onboard.laws import ForceTorque, Legacy, MotorForces
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.record import make_fleet

BOOT = {
    "pid_rate.roll_kp": 250,
    "pid_rate.roll_ki": 500,
    "pid_rate.roll_kd": 2.5,
    "pid_rate.yaw_ki": 16.7,
    "pid_attitude.yaw_kd": 0.35,
    "pid_attitude.pitch_ki": 3,
    "velCtlPid.vzKi": 15,
    "velCtlPid.vxKp": 25,
    "posCtlPid.zKi": 0.5,
    "posCtlPid.xKp": 2,
    "posCtlPid.thrustBase": 36000,
    "posCtlPid.thrustMin": 20000,
    "posCtlPid.rLimit": 20,
    "posCtlPid.xVelMax": 1,
    "ctrlMel.kp_xy": 0.4,
    "ctrlMel.i_range_m_z": 1500,
    "ctrlMel.mass": 0.029,
    "ctrlMel.massThrust": 132000,
    "ctrlMel.kd_omega_rp": 200,
    "ctrlLee.Kpos_Px": 7,
    "ctrlLee.J_z": 29.261652e-6,
    "ctrlLee.Kw_z": 0.002,
    "flightmode.stabModeRoll": 1,
    "flightmode.stabModeYaw": 0,
    "hlCommander.vtoff": 0.5,
    "kalman.maxPos": 100,
    "kalman.pNAcc_z": 1,
    "kalman.resetEstimation": 0,
    "locSrv.extPosStdDev": 0.01,
    "locSrv.extQuatStdDev": 0.0045,
    "stabilizer.controller": 1,
    "stabilizer.stop": 0,
    "supervisor.landedTimeout": 3000,
    "supervisor.prefltTimeout": 30000,
    "supervisor.tmblChckEn": 1,
    "powerDist.idleThrust": 0,
    "velCtlPid.vxKFF": 0,
    "posCtlPid.zKff": 0,
    "pid_rate.yaw_kff": 0,
}


@pytest.mark.parametrize(("name", "value"), BOOT.items())
def test_boot_values_are_the_firmwares(name, value):
    assert Onboard(CRAZYFLIE_21).get(name) == pytest.approx(value)


def test_boot_values_of_the_brushless():
    onboard = Onboard(CRAZYFLIE_21_BRUSHLESS)
    values = [
        onboard.get(n)
        for n in (
            "pid_rate.roll_kp",
            "pid_rate.pitch_ki",
            "posCtlPid.thrustBase",
            "ctrlLee.mass",
        )
    ]
    assert values == pytest.approx([200, 400, 30000, 0.0393])


def test_every_parameter_can_be_written_and_read():
    onboard = Onboard(CRAZYFLIE_21)
    for k, name in enumerate(
        sorted(
            set(parameters.PARAMETER_PLACES)
            - {"stabilizer.controller", "stabilizer.estimator"}
        )
    ):
        onboard.set(name, k % 7)
        assert onboard.get(name) == k % 7
    assert len({str(path) for path in parameters.PARAMETER_PLACES.values()}) == len(
        parameters.PARAMETER_PLACES
    )


def test_a_gain_acts():
    onboard = Onboard(CRAZYFLIE_21)
    loop.run(onboard.rows, 200.0, 0, 0, 0, 0, 0, 9.80665)
    onboard.set("pid_rate.roll_ki", 0.0)
    onboard.set("flightmode.stabModeRoll", 0)
    for kp in (100.0, 300.0):
        onboard.set("pid_rate.roll_kp", kp)
        onboard.setpoints.rpyt_raw(0, 0, 0, 0)
        onboard.setpoints.rpyt_raw(10.0, 0, 0, 30000)
        loop.run(onboard.rows, 4.0, 0, 0, 0, 0, 0, 9.80665)
        assert onboard.log("controller.cmd_roll") == 10 * kp


def test_every_log_variable_is_a_number():
    onboard = Onboard(CRAZYFLIE_21)
    loop.run(onboard.rows, 200.0, 0, 0, 0.1, 0, 0, 9.80665)
    assert all(math.isfinite(onboard.log(name)) for name in logs.FIRMWARE_LOG_READERS)
    assert onboard.log("gyro.z") == pytest.approx(math.degrees(0.1), abs=1e-3)
    assert onboard.log("acc.z") == pytest.approx(1.0)
    assert onboard.log("pm.vbatMV") == 4200
    assert onboard.log("supervisor.info") == onboard.info
    assert onboard.log("sys.canfly") == 1


def test_drones_of_one_array_do_not_know_of_each_other():
    rows = make_fleet(3, CRAZYFLIE_21)
    drones = [Onboard(CRAZYFLIE_21, rows, k) for k in range(3)]
    loop.run(rows, 200.0, 0, 0, 0, 0, 0, 9.80665)
    drones[1].setpoints.manual(0.3, 0, 0, 0)
    drones[2].set("pid_rate.roll_kp", 7)
    loop.run(rows, 10.0, 0, 0, 0, 0, 0, 9.80665)
    assert [bool(np.any(d.record["motors"])) for d in drones] == [False, True, False]
    assert [d.get("pid_rate.roll_kp") for d in drones] == [250, 250, 7]
    drones[0].trajectories.upload(0, np.ones((1, 33)))
    assert not drones[1].trajectories.is_defined(0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda d: d.set("pid_rate.rol_kp", 1),
            "firmware parameter: found pid_rate.rol_kp; .*pid_rate.roll_kp",
        ),
        (lambda d: d.get("xyz"), "firmware parameter: found xyz"),
        (
            lambda d: d.set("pid_rate.roll_kp", math.nan),
            "pid_rate.roll_kp: found nan; allowed: a finite number",
        ),
        (lambda d: d.set("pid_rate.roll_kp", "3"), "found 3; allowed: a finite number"),
        (
            lambda d: d.log("stateEstimat.x"),
            "firmware log variable: found stateEstimat.x; .*stateEstimate.x",
        ),
        (
            lambda d: d.set("stabilizer.controller", "lqr"),
            "found lqr; allowed: pid, mellinger, indi, brescianini, lee, or 0, 1",
        ),
        (
            lambda d: d.set("stabilizer.controller", 6),
            r"found 6; allowed: .*Offer your own with register\(name, law\)",
        ),
        (
            lambda d: d.register("pid", print),
            "register: controller: found pid; allowed: a callable under another name",
        ),
        (lambda d: d.register("mine", 3), "register: controller: found mine"),
        (
            lambda d: FirmwareLaw("Indi", 0.12),
            "FirmwareLaw: name: found Indi; allowed: one of Pid, Mellinger, Lee",
        ),
        (
            lambda d: FirmwareLaw("Pid", 0.12),
            "cffirmware: found no such module.*make bindings_python",
        ),
    ],
)
def test_what_is_wrong_is_said_with_what_is_allowed(call, words, monkeypatch):
    monkeypatch.setitem(sys.modules, "cffirmware", None)
    with pytest.raises(ConfigError, match=words):
        call(Onboard(CRAZYFLIE_21))


def hovering():
    return Body().fly(0.2).hovering(1.0)


def test_a_controller_of_the_users_own_flies():
    body, seen = hovering(), []

    def law(setpoint, estimate, gyro, dt):
        seen.append(dt)
        a = 1.5 * (setpoint.p - estimate.p) - 2 * estimate.v + [0, 0, 9.80665]
        tilt = [-a[1] / 9.8, a[0] / 9.8]
        q = estimate.q
        x, y = (5 * (tilt[k] - 2 * q[k]) - gyro[k] for k in (0, 1))
        return ForceTorque(
            body.platform.mass * a[2],
            20 * 16.8e-6 * x,
            20 * 16.8e-6 * y,
            -16.8e-6 * 8 * gyro[2],
        )

    body.onboard.register("mine", law)
    body.onboard.set("stabilizer.controller", "mine")
    body.fly(6.0, lambda: body.onboard.setpoints.position((0.2, -0.1, 1.3), 0.0))
    assert body.p == pytest.approx([0.2, -0.1, 1.3], abs=0.03)
    assert set(seen) == {0.002}
    assert len(seen) == pytest.approx(3000, abs=2)
    assert body.onboard.get("stabilizer.controller") == 6
    body.onboard.set("stabilizer.controller", 1)
    body.fly(1.0, lambda: body.onboard.setpoints.position((0.2, -0.1, 1.3), 0.0))
    assert len(seen) < 3010


def answer_of(value, ms=6):
    onboard = Onboard(CRAZYFLIE_21)
    loop.run(onboard.rows, 200.0, 0, 0, 0, 0, 0, 9.80665)
    onboard.register("mine", lambda *told: value)
    onboard.set("stabilizer.controller", "mine")
    for _ in range(ms):
        loop.run(onboard.rows, 1.0, 0, 0, 0, 0, 0, 9.80665)
        if onboard.record["law_due"]:
            onboard.obey_law()
    return onboard.record["motors"].tolist()


def test_answers_of_a_law():
    assert answer_of(MotorForces(0.03, 0.06, 0.09, 0.12)) == pytest.approx(
        [0.25, 0.5, 0.75, 1.0], rel=1e-4
    )
    half = pytest.approx([0.5] * 4, rel=1e-4)
    assert answer_of(ForceTorque(0.24, 0, 0, 0)) == half
    assert answer_of(Legacy(32767.5, 0, 0, 0)) == half
    assert answer_of(ForceTorque(math.nan, 0, 0, 0)) == [0.0] * 4
    with pytest.raises(
        ConfigError,
        match=r"controller 'mine': its answer: found \(1, 2\); allowed: ForceTorque",
    ):
        answer_of((1, 2))


def test_a_law_is_told_si_in_the_bodys_signs():
    told = {}
    onboard = Onboard(CRAZYFLIE_21)
    loop.run(onboard.rows, 200.0, 0, 0, 0, 0, 0, 9.80665)
    onboard.register(
        "mine", lambda s, *rest: told.update(s=s) or MotorForces(0, 0, 0, 0)
    )
    onboard.set("stabilizer.controller", "mine")
    onboard.setpoints.manual(0.3, 0.1, 0.2, 0.3, rates=True)
    onboard.obey_law()
    assert told["s"].w == pytest.approx([0.1, 0.2, 0.3])
    assert told["s"].thrust == pytest.approx(0.3)
    onboard.setpoints.z_distance(0.1, 0.2, 0.3, 1.5)
    onboard.obey_law()
    assert (told["s"].roll, told["s"].pitch, told["s"].p[2]) == pytest.approx(
        (0.1, 0.2, 1.5)
    )
    assert told["s"].modes.z == 1


@pytest.fixture
def stand_in(monkeypatch):
    """A small stand-in for the bindings, with the same names: not the firmware."""
    firmware = ModuleType("cffirmware")

    def structure():
        vectors = (
            "position",
            "velocity",
            "acceleration",
            "jerk",
            "attitudeQuaternion",
            "gyro",
        )
        return SimpleNamespace(
            **{
                part: SimpleNamespace()
                for part in (*vectors, "mode", "attitude", "attitudeRate")
            }
        )

    firmware.setpoint_t = firmware.state_t = firmware.sensorData_t = structure
    firmware.control_t = lambda: SimpleNamespace(controlMode=0)
    firmware.modeDisable, firmware.modeAbs, firmware.modeVelocity = 0, 1, 2
    firmware.controlModeForceTorque = 1
    firmware.calls = []
    firmware.controllerPidInit = lambda: firmware.calls.append("init")

    def controller_pid(control, setpoint, sensors, state, ms):
        firmware.calls.append((setpoint, sensors, state, ms))
        control.thrust, control.roll, control.pitch, control.yaw = 32767.5, 0, 0, 0

    class Memory:
        pass

    firmware.controllerLee_t = Memory
    firmware.controllerLeeInit = lambda memory: setattr(memory, "k", 0.24)

    def controller_lee(memory, control, setpoint, sensors, state, ms):
        control.controlMode = 1
        control.thrustSi, control.torqueX, control.torqueY, control.torqueZ = (
            memory.k,
            0,
            0,
            0,
        )

    firmware.controllerPid, firmware.controllerLee = controller_pid, controller_lee
    monkeypatch.setitem(sys.modules, "cffirmware", firmware)
    return firmware


@pytest.mark.parametrize("name", ["Pid", "Lee"])
def test_the_firmwares_bindings_are_called_with_its_units_and_signs(stand_in, name):
    onboard = Onboard(CRAZYFLIE_21)
    loop.run(onboard.rows, 200.0, 0, 0, 0, 0, 0, 9.80665)
    onboard.register("real", FirmwareLaw(name, 0.12))
    onboard.set("stabilizer.controller", "real")
    onboard.setpoints.manual(0.3, 0.1, 0.2, 0.3, rates=True)
    loop.run(onboard.rows, 2.0, 0.1, 0.2, 0.3, 0, 0, 9.80665)
    onboard.obey_law()
    loop.run(onboard.rows, 2.0, 0.1, 0.2, 0.3, 0, 0, 9.80665)
    # the firmware's motors take integers of 16 bits
    assert onboard.record["motors"].tolist() == pytest.approx([0.5] * 4, rel=1e-4)
    if name == "Pid":
        assert stand_in.calls[0] == "init"
        setpoint, sensors, state, ms = stand_in.calls[1]
        assert setpoint.attitudeRate.pitch == pytest.approx(-math.degrees(0.2))
        assert setpoint.thrust == pytest.approx(0.3 * 65535 / 0.48)
        assert sensors.gyro.y == pytest.approx(math.degrees(onboard.gyro[1]), rel=1.0)
        assert state.attitudeQuaternion.w == pytest.approx(1.0, abs=1e-3)
        assert ms == 0
