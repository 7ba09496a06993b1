"""Faults that are set by name and number of the drone, and held while they last."""

import pytest
from virtual_time import virtual

from crazychoir.errors import ConfigError
from crazychoir.radio.virtual.fault_control import FaultControl, charge_at_voltage
from crazychoir.radio.virtual.server import VirtualServer
from crazychoir.radio.virtual.setup import place_on_grid


def make_control(clock, n: int = 3) -> tuple[VirtualServer, FaultControl]:
    """Return a server without sockets, and the control of its faults."""
    hall = place_on_grid(n, 19850, None)
    server = VirtualServer(clock, hall.world(0), hall.seats, hall.poses)
    return server, FaultControl(server.world, server.ports, server.faults)


def losses(server: VirtualServer) -> list[float]:
    return [fault.loss for fault in server.faults.values()]


@virtual
async def test_drones_are_named_by_number_or_all_together(clock) -> None:
    server, control = make_control(clock)
    control.set_faults({"all": {"loss": 0.1}})
    assert losses(server) == [0.1, 0.1, 0.1]
    control.set_faults({"0, 02": {"loss": 0.2}, "1": {"loss": 0.3}})
    assert losses(server) == [0.2, 0.3, 0.2]


@pytest.mark.parametrize(
    ("wanted", "text"),
    [
        ({"0": {"loss": 0.5}, "7": {"loss": 0.5}}, "found 7; allowed: all, 0, 1, 2"),
        ({"0": {"loss": 0.5}, "": {"loss": 0.5}}, "allowed: all, 0, 1, 2"),
        ({"0": {"loss": 0.5}, "1": {"loss": 2.0}}, "0 to 1"),
        ({"0": 3}, "{id: {name: value}}"),
    ],
)
def test_one_fault_that_is_not_allowed_keeps_all_others_from_being_set(
    wanted, text
) -> None:
    @virtual
    async def check(clock) -> None:
        server, control = make_control(clock)
        with pytest.raises(ConfigError) as error:
            control.set_faults(wanted)
        assert text in str(error.value)
        assert losses(server) == [0.0, 0.0, 0.0]

    check()


@virtual
async def test_a_new_exchange_of_bodies_undoes_the_earlier_ones(clock) -> None:
    server, control = make_control(clock)
    control.set_faults({"0": {"swap": 1}})
    assert [fault.swap for fault in server.faults.values()] == [1.0, 0.0, -1.0]
    control.set_faults({"2": {"swap": 0}})
    assert [fault.swap for fault in server.faults.values()] == [2.0, -1.0, 0.0]


@virtual
async def test_a_voltage_is_held_and_a_body_is_put_back_at_its_home(clock) -> None:
    server, control = make_control(clock)
    control.set_faults({"1": {"voltage": 3.4}})
    for _ in range(500):
        control.hold()
        server.world.step()
    assert server.world.vbat(1) == pytest.approx(3.4, abs=0.05)
    assert server.world.vbat(0) > 4.0
    home = server.world.states[1, :3].copy()
    server.world.states[1, 0] += 2.0
    control.set_faults({"1": {"home": 1}})
    assert server.world.states[1, :3] == pytest.approx(home)


def test_the_charge_of_a_voltage():
    battery = place_on_grid(1, 19850, ()).world(0).platforms[0].battery
    assert charge_at_voltage(4.2, battery) == pytest.approx(1.0)
    assert charge_at_voltage(3.87, battery) == pytest.approx(
        0.3, abs=1e-3
    )  # the firmware's table: 30 %
    assert charge_at_voltage(3.0, battery) > 0.0
