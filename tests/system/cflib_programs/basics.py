"""Connect, log, parameters, console, memories, statistics."""

import itertools
import threading
import time

from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.mem import MemoryElement
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie
from cflib.crazyflie.syncLogger import SyncLogger


def connect_with_callbacks(uri, cache):
    """The asynchronous way: link established, connected, fully connected, disconnected, in this order."""
    cf, order, full, gone = (
        Crazyflie(rw_cache=cache),
        [],
        threading.Event(),
        threading.Event(),
    )
    cf.link_established.add_callback(lambda uri: order.append("link"))
    cf.connected.add_callback(lambda uri: order.append("connected"))
    cf.fully_connected.add_callback(lambda uri: (order.append("full"), full.set()))
    cf.disconnected.add_callback(lambda uri: (order.append("disconnected"), gone.set()))
    cf.connection_failed.add_callback(lambda uri, why: order.append(f"failed {why}"))
    cf.open_link(uri)
    assert full.wait(10), order
    assert cf.is_connected()
    assert cf.platform.get_protocol_version() == 12
    cf.close_link()
    assert gone.wait(5)
    assert order == ["link", "connected", "full", "disconnected"], order


def log_synchronously(uri, cache):
    """Ten entries at 100 Hz, by their own clock."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        config = LogConfig(name="Stabilizer", period_in_ms=10)
        for name in ("stabilizer.roll", "stabilizer.pitch", "stabilizer.yaw"):
            config.add_variable(name, "float")
        times = []
        with SyncLogger(scf, config) as logger:
            for stamp, data, _ in logger:
                assert abs(data["stabilizer.roll"]) < 1.0
                times.append(stamp)
                if len(times) == 20:
                    break
        assert [b - a for a, b in itertools.pairwise(times)] == [10] * 19, times


def log_by_callback(uri, cache):
    """All types, one as a half float; two blocks at once, one stopped and started again."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        seen, slow = [], []
        fast = LogConfig(name="types", period_in_ms=20)
        fast.add_variable("pm.vbat", "FP16")
        fast.add_variable("pm.vbatMV")
        fast.add_variable("pm.state")
        fast.add_variable("stateEstimateZ.quat")
        fast.add_variable("motor.m1req")
        fast.add_variable("stateEstimate.z", "int16_t")
        fast.add_variable("radio.isConnected", "uint8_t")
        other = LogConfig(name="slow", period_in_ms=100)
        other.add_variable("supervisor.info", "uint16_t")
        for config, kept in ((fast, seen), (other, slow)):
            scf.cf.log.add_config(config)
            config.data_received_cb.add_callback(
                lambda stamp, data, _, kept=kept: kept.append(data)
            )
            config.start()
        time.sleep(0.5)
        fast.stop()
        time.sleep(0.1)
        count = len(seen)
        time.sleep(0.2)
        assert 15 <= count <= len(seen) <= count + 1, (count, len(seen))
        fast.start()
        time.sleep(0.2)
        assert len(seen) > count + 5
        assert abs(seen[-1]["pm.vbat"] - 1e-3 * seen[-1]["pm.vbatMV"]) < 0.01
        assert seen[-1]["radio.isConnected"] == 1
        assert slow[-1]["supervisor.info"] & 0b1000, slow[-1]
        fast.delete()


def log_too_much(uri, cache):
    """What cflib itself refuses, and what only the drone does."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        large = LogConfig(name="large", period_in_ms=10)
        for axis in ("x", "y", "z", "vx", "vy", "vz", "roll"):
            large.add_variable(f"stateEstimate.{axis}", "float")
        try:
            scf.cf.log.add_config(large)
        except AttributeError:
            pass
        else:
            raise AssertionError("28 bytes fit into no packet")
        unknown = LogConfig(name="unknown", period_in_ms=10)
        unknown.add_variable("no.such", "float")
        try:
            scf.cf.log.add_config(unknown)
        except KeyError:
            return
        raise AssertionError("there is no no.such")


def parameters(uri, cache):
    """Read, write, read back by callback; a group's callback; by name without the table; what is read-only."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        scf.wait_for_params()
        param, heard, group = scf.cf.param, threading.Event(), []
        assert param.get_value("pid_attitude.roll_kp") == "6.0"
        assert param.get_value("deck.bcFlow2") == "1"
        assert param.get_value("supervisor.prefltTimeout") == "30000"
        param.add_update_callback(
            group="pid_attitude", name="roll_kp", cb=lambda name, value: heard.set()
        )
        param.add_update_callback(
            group="pid_attitude", cb=lambda name, value: group.append((name, value))
        )
        param.set_value("pid_attitude.roll_kp", "5.5")
        assert heard.wait(2)
        assert param.get_value("pid_attitude.roll_kp") == "5.5"
        assert group == [("pid_attitude.roll_kp", "5.5")]
        param.set_value_raw("pid_attitude.pitch_kp", 0x06, 4.0)
        heard.clear()
        param.add_update_callback(
            group="pid_attitude", name="pitch_kp", cb=lambda name, value: heard.set()
        )
        param.request_param_update("pid_attitude.pitch_kp")
        assert heard.wait(2)
        assert param.get_value("pid_attitude.pitch_kp") == "4.0"
        for controller in (
            2,
            77,
            1,
        ):  # the firmware takes any number, and flies on with what it has
            heard.clear()
            param.add_update_callback(
                group="stabilizer",
                name="controller",
                cb=lambda name, value: heard.set(),
            )
            param.set_value("stabilizer.controller", controller)
            assert heard.wait(2), controller
        try:
            param.set_value("deck.bcFlow2", 0)
        except AttributeError:
            return
        raise AssertionError("deck.bcFlow2 is read-only")


def persistent_parameters(uri, cache):
    """Store, state, clear, default values, extended types."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        scf.wait_for_params()
        param, name = scf.cf.param, "pid_rate.roll_kp"

        def asked(function, *args):
            answers, done = [], threading.Event()
            function(*args, lambda *answer: (answers.append(answer), done.set()))
            assert done.wait(2), function
            return answers[0]

        assert param.toc.get_element_by_complete_name(name).is_persistent()
        assert not param.toc.get_element_by_complete_name(
            "hlCommander.vtoff"
        ).is_persistent()
        assert asked(param.persistent_get_state, name)[1].is_stored is False
        param.set_value(name, 240.0)
        assert asked(param.persistent_store, name) == (name, True)
        state = asked(param.persistent_get_state, name)[1]
        assert (state.is_stored, state.default_value, state.stored_value) == (
            True,
            250.0,
            240.0,
        )
        assert asked(param.persistent_clear, name) == (name, True)
        assert asked(param.persistent_get_state, name)[1].stored_value is None
        assert asked(param.get_default_value, name) == (name, 250.0)
        assert asked(param.get_default_value, "deck.bcFlow2") == ("deck.bcFlow2", None)


def console(uri, cache):
    """The console brings all that the drone has said since it was switched on, as soon as a program listens."""
    cf, text, full = Crazyflie(rw_cache=cache), [], threading.Event()
    cf.console.receivedChar.add_callback(text.append)
    cf.fully_connected.add_callback(lambda uri: full.set())
    cf.open_link(uri)
    assert full.wait(10)
    cf.close_link()
    assert "is up and running" in "".join(text), text


def memories(uri, cache):
    """EEPROM, LEDs, the tester, the lighthouse's, decks."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        mem, done = scf.cf.mem, threading.Event()
        (eeprom,) = mem.get_mems(MemoryElement.TYPE_I2C)
        eeprom.update(lambda memory: done.set())
        assert done.wait(2)
        assert eeprom.valid
        assert eeprom.elements["radio_channel"] == 80
        eeprom.elements["radio_channel"] = 100
        done.clear()
        eeprom.write_data(lambda memory, address: done.set())
        assert done.wait(2)
        done.clear()
        eeprom.update(lambda memory: done.set())
        assert done.wait(2)
        assert eeprom.valid
        assert eeprom.elements["radio_channel"] == 100
        (tester,) = mem.get_mems(MemoryElement.TYPE_MEMORY_TESTER)
        done.clear()
        tester.read_data(5, 100, lambda memory: done.set())
        assert done.wait(2)
        assert tester.readValidationSuccess
        (leds,) = mem.get_mems(MemoryElement.TYPE_DRIVER_LED)
        leds.leds[0].set(r=100, g=0, b=0)
        done.clear()
        leds.write_data(lambda memory, address: done.set())
        assert done.wait(2)
        (decks,) = mem.get_mems(MemoryElement.TYPE_DECK_MEMORY)
        done.clear()
        decks.query_decks(lambda found: done.set())
        assert done.wait(2)
        failed = threading.Event()
        mem.mem_read_failed_cb.add_callback(lambda memory, address, data: failed.set())
        (trajectory,) = mem.get_mems(MemoryElement.TYPE_TRAJ)
        mem.read(trajectory, 4090, 20)
        assert failed.wait(2)


def lighthouse(uri, cache):
    """Geometries are written, made persistent, and read back."""
    from cflib.crazyflie.mem import LighthouseBsGeometry, LighthouseMemHelper
    from cflib.localization import LighthouseConfigWriter

    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        geometry = LighthouseBsGeometry()
        geometry.origin, geometry.valid = [1.0, 2.0, 3.0], True
        done, read = threading.Event(), []
        writer = LighthouseConfigWriter(scf.cf, nr_of_base_stations=2)
        writer.write_and_store_config(lambda success: done.set(), geos={0: geometry})
        assert done.wait(5)
        done.clear()
        LighthouseMemHelper(scf.cf).read_all_geos(
            lambda geos: (read.append(geos), done.set())
        )
        assert done.wait(5)
        assert read[0][0].origin == [1.0, 2.0, 3.0], read


def statistics(uri, cache):
    """Latency; and requests that get no answer do not disturb."""
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        cf, latencies, packets = scf.cf, [], []
        cf.link_statistics.latency_updated.add_callback(latencies.append)
        cf.loc.receivedLocationPacket.add_callback(packets.append)
        cf.appchannel.send_packet(b"nobody")
        cf.platform.set_continous_wave(False)
        cf.platform.send_user_notification(True)
        cf.loc.send_short_lpp_packet(1, b"nothing")
        time.sleep(0.6)
        assert 3 <= len(latencies) <= 8, latencies
        assert 0.0 < latencies[-1] < 200.0, latencies
        assert [packet.type for packet in packets] == [cf.loc.LPS_SHORT_LPP_PACKET]


def multiranger(uri, cache):
    """Nothing is near in an empty room but the floor."""
    from cflib.utils.multiranger import Multiranger

    with (
        SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf,
        Multiranger(scf) as ranger,
    ):
        time.sleep(0.5)
        assert ranger.front is ranger.up is None
        assert ranger.down is not None
        assert ranger.down < 0.05


PROGRAMS = (
    console,
    connect_with_callbacks,
    log_synchronously,
    log_by_callback,
    log_too_much,
    parameters,
    persistent_parameters,
    memories,
    lighthouse,
    statistics,
    multiranger,
)
