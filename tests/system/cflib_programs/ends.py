"""Ends of flights: the supervisor, emergency stops, poses from outside, restarts, a drone that is not there."""

import threading
import time

from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie
from cflib.crtp.crtpstack import CRTPPacket, CRTPPort


def supervisor(uri, cache):
    """States in words; disarmed it does not fly, armed it does."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        supervisor = scf.cf.supervisor
        assert {"Is auto armed", "Can fly"} <= set(supervisor.read_state_list())
        assert not supervisor.is_crashed
        scf.cf.high_level_commander.takeoff(0.4, 1.0)
        time.sleep(1.3)
        assert supervisor.is_flying
        assert supervisor.hl_control_active
        scf.cf.high_level_commander.land(0.0, 1.0)
        time.sleep(3.5)
        assert not supervisor.is_flying


def emergency_stop(uri, cache):
    """The drone falls at once, and stays locked until it is switched on again."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        motors, config = [], LogConfig(name="motors", period_in_ms=10)
        config.add_variable("motor.m1", "uint16_t")
        scf.cf.log.add_config(config)
        config.data_received_cb.add_callback(
            lambda stamp, data, _: motors.append(data["motor.m1"])
        )
        config.start()
        scf.cf.high_level_commander.takeoff(0.3, 1.0)
        time.sleep(1.2)
        assert motors[-1] > 10000
        scf.cf.supervisor.send_emergency_stop()
        time.sleep(0.3)
        assert motors[-1] == 0
        assert scf.cf.supervisor.is_locked
        scf.cf.high_level_commander.takeoff(0.3, 1.0)
        time.sleep(0.5)
        assert motors[-1] == 0


def emergency_stop_watchdog(uri, cache):
    """Repeated it flies on; a second without it, it is locked."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        scf.cf.high_level_commander.takeoff(0.3, 1.0)
        for _ in range(4):
            scf.cf.supervisor.send_emergency_stop_watchdog()
            time.sleep(0.4)
        assert not scf.cf.supervisor.is_locked
        time.sleep(1.1)
        assert scf.cf.supervisor.is_locked


def poses_from_outside(uri, cache):
    """Positions and poses are taken, and logged as they came."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        last, config = {}, LogConfig(name="outside", period_in_ms=10)
        for name in ("locSrv.x", "locSrv.qw", "kalman.varX", "stateEstimate.x"):
            config.add_variable(name, "float")
        scf.cf.log.add_config(config)
        config.data_received_cb.add_callback(lambda stamp, data, _: last.update(data))
        config.start()
        time.sleep(0.2)
        x = last["stateEstimate.x"]
        for _ in range(10):
            scf.cf.extpos.send_extpose(x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
            scf.cf.loc.send_extpos([x, 0.0, 0.0])
            time.sleep(0.02)
        scf.cf.loc.send_extpose([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])
        time.sleep(0.1)
        assert abs(last["locSrv.x"] - x) < 1e-6
        assert last["locSrv.qw"] == 1.0
        assert last["kalman.varX"] < 1e-3


def restart_by_a_wrong_packet(uri, cache):
    """A set-point that is too short: the firmware restarts, the link is lost, and it can be had again."""
    cf, lost, full = Crazyflie(rw_cache=cache), threading.Event(), threading.Event()
    cf.connection_lost.add_callback(lambda uri, why: lost.set())
    cf.fully_connected.add_callback(lambda uri: full.set())
    cf.open_link(uri)
    assert full.wait(10)
    packet = CRTPPacket()
    packet.port, packet.data = CRTPPort.COMMANDER_GENERIC, bytes([10, 0, 0])
    cf.send_packet(packet)
    assert lost.wait(3)
    time.sleep(1.3)
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        scf.wait_for_params()


def nobody_there(uri, cache):
    """A connection to a port without a drone fails, and a callback gets the reason."""
    cf, failed = Crazyflie(rw_cache=cache), threading.Event()
    cf.connection_failed.add_callback(lambda uri, why: failed.set())
    cf.open_link("udp://127.0.0.1:9")
    assert failed.wait(3)
    cf.close_link()


PROGRAMS = (
    supervisor,
    emergency_stop,
    emergency_stop_watchdog,
    poses_from_outside,
    restart_by_a_wrong_packet,
    nobody_there,
)
