"""The states of running drones, as a script reads them."""

from types import SimpleNamespace

import pytest
from virtual_time import virtual

from crazychoir.api.running.async_drones import AsyncDrone, DroneOrders
from crazychoir.api.running.receipts import OrderFailed
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.types import State, Status


class HearingWindow:
    """A window on drone 0, with an agent that obeys or with none.

    `hear` gives it a state with an age, `report` a status, `end` a result.
    """

    def __init__(self, clock):
        self.clock = clock
        self.config = SimpleNamespace(ids=(0,))
        self.obeys = False

    def read(self, topic, i, function, rate=None):
        names = {"state": "hear", "status": "report", "result": "end"}
        setattr(self, names[topic.name], function)

    def require_operator(self):
        pass

    def is_there(self, i):
        return self.obeys

    async def order_one(self, i, verb, seconds, arguments, accept):
        accept()
        await self.clock.sleep(1.0)
        return True, ("done", "")


@virtual
async def test_state_has_its_present_age_and_a_stale_one_is_not_returned(clock):
    window = HearingWindow(clock)
    drone = AsyncDrone(DroneOrders(window), (0,))
    window.hear(State.at([1.0, 2.0, 3.0]), 0.05)
    await clock.sleep(0.1)
    state = await drone.state()
    assert state.p.tolist() == [1.0, 2.0, 3.0]
    assert state.age == pytest.approx(0.15)
    await clock.sleep(DRONE_TOPICS.state.max_age)
    with pytest.raises(OrderFailed, match="drone 0: state silent: no new state"):
        await drone.state()
    window.hear(State.at([1.5, 2.0, 3.0]), 0.0)
    assert (await drone.state()).p[0] == 1.5


@virtual
async def test_a_command_that_fails_says_what_the_drone_has_reported(clock):
    window = HearingWindow(clock)
    orders = DroneOrders(window)
    window.report(Status("ended", note="the cameras do not see it"), 0.0)
    with pytest.raises(OrderFailed, match="reported: the cameras do not see it"):
        await orders.give("take-off", {0: {}}, 5.0, True)


@virtual
async def test_a_command_after_the_end_of_a_flight_says_why_it_ended(clock):
    window = HearingWindow(clock)
    orders = DroneOrders(window)
    window.end({"success": False, "reason": "drone 0: seen on the floor"}, 0.0)
    match = "drone 0: go-to absent: its flight is over: seen on the floor"
    with pytest.raises(OrderFailed, match=match):
        await orders.give("go-to", {0: {}}, 5.0, True)


@virtual
async def test_the_end_of_an_earlier_flight_is_no_reason_once_the_drone_obeys(clock):
    for waits in (True, False):
        window = HearingWindow(clock)
        orders = DroneOrders(window)
        window.end({"success": False, "reason": "drone 0: seen on the floor"}, 0.0)
        window.obeys = True
        await orders.give("take-off", {0: {}}, 5.0, waits)
        window.obeys = False
        with pytest.raises(OrderFailed, match="drone 0: go-to absent: ") as failed:
            await orders.give("go-to", {0: {}}, 5.0, True)
        assert "seen on the floor" not in str(failed.value)
