"""The simulated radio against the equations in its docstrings."""

import numpy as np
import pytest

from crazychoir.radio.survey import simulated_radio
from crazychoir.radio.survey.interference import (
    Bluetooth,
    Jammer,
    UsageTimes,
    WifiNetwork,
    draw_frames,
)
from crazychoir.radio.survey.simulated_radio import (
    RECEIVER_MODEL,
    RadioRoom,
    SimulatedRadio,
    random_room,
    reception_probability,
)


def test_one_bit_in_a_thousand_is_wrong_at_the_sensitivity():
    sinr = 10.0 ** ((-82.0 - simulated_radio.RECEIVER_MODEL.noise) / 10.0)
    assert 1.0 - reception_probability(np.array([sinr]))[0] ** (
        1.0 / RECEIVER_MODEL.packet_bits
    ) == pytest.approx(1e-3, rel=0.2)


def test_a_packet_comes_through_where_no_bit_is_wrong():
    assert reception_probability(np.array([0.0]))[0] == pytest.approx(
        0.5**RECEIVER_MODEL.packet_bits
    )
    assert reception_probability(np.array([100.0]))[0] == pytest.approx(1.0)
    assert np.all(np.diff(reception_probability(np.linspace(0.0, 30.0, 50))) > 0.0)


ROOMS = {
    "a network": (WifiNetwork(37.0, -55.0, 0.4, 0.001, UsageTimes(1.0, 2.0, 1)),),
    "a jammer": (Jammer(40.0, -68.0, UsageTimes(1.5, 0.5, 2)),),
    "a phone": (Bluetooth(-50.0, 0.5),),
    "all": (
        WifiNetwork(37.0, -68.0, 0.6, 0.002, UsageTimes(1.0, 1.0, 3)),
        WifiNetwork(42.0, -60.0, 0.2, 0.0005, UsageTimes(0.5, 2.0, 4)),
        Jammer(37.0, -72.0, UsageTimes(1.0, 3.0, 5)),
        Bluetooth(-50.0, 0.5),
    ),
}


@pytest.mark.parametrize("sources", ROOMS.values(), ids=ROOMS)
def test_what_is_expected_is_what_is_measured_in_the_long_run(sources):
    room = RadioRoom({38: -62.0}, sources)
    radio = SimulatedRadio(room, seed=7)
    rates = []
    for _ in range(600):
        rates.append(radio.measure(38, 200, 0).acknowledged.mean())
        radio.now += 4.0  # by then they are used or not by another draw
    error = np.std(rates) / np.sqrt(len(rates))
    assert np.mean(rates) == pytest.approx(room.expected(38), abs=4.0 * error + 1e-3)
    assert room.expected(38) < 0.99


def test_an_unused_network_sends_beacons():
    draw = np.random.default_rng(9)
    network = WifiNetwork(37.0, -55.0, 0.6, 0.001, UsageTimes(1e-9, 1e9, 1))
    sent = network.sends(37, np.arange(0.0, 20.0, 0.001), draw).mean()
    assert sent == pytest.approx(network.share(37, False), rel=0.2)
    assert 0.005 < network.share(37, False) < 0.02


def test_while_all_is_in_use_less_comes_through():
    room = RadioRoom({38: -62.0}, ROOMS["all"])
    assert room.expected(38, in_use=True) < room.expected(38) - 0.05


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8])
def test_frames_take_their_share_of_the_time(share):
    draw = np.random.default_rng(3)
    on = np.concatenate(
        [
            draw_frames(np.arange(0.0, 0.1, 0.0005), share, 0.001, draw)
            for _ in range(200)
        ]
    )
    assert on.mean() == pytest.approx(share, abs=0.03)
    stays = np.mean(on[1:] == on[:-1])
    assert (
        stays > 1.3 * (share**2 + (1.0 - share) ** 2) - 0.2
    )  # a frame is longer than half a millisecond


def test_usage_share_does_not_depend_on_how_often_it_is_sampled():
    uses = UsageTimes(2.0, 6.0, seed=5)
    often, seldom = UsageTimes(2.0, 6.0, seed=5), UsageTimes(2.0, 6.0, seed=5)
    times = np.arange(0.0, 20000.0, 0.5)
    on = np.concatenate([often.at(part) for part in np.split(times, 400)])
    assert on.mean() == pytest.approx(uses.share, abs=0.02)
    assert np.array_equal(on, seldom.at(times))


def test_reflections_keep_the_power_and_change_within_a_few_megahertz():
    draw = np.random.default_rng(11)
    channels = np.arange(84.0)
    gains = np.array([simulated_radio._draw_gains(channels, draw) for _ in range(400)])
    assert np.mean(10.0 ** (gains / 10.0)) == pytest.approx(1.0, abs=0.05)
    assert (
        np.abs(np.diff(gains, axis=1)).mean()
        < 0.3 * np.abs(gains[:, 40:] - gains[:, :-40]).mean()
    )


def test_a_room_is_that_of_its_seed():
    a, b, c = (random_room(seed, (10, 20)) for seed in (1, 1, 2))
    assert (
        (a.signal, a.expected(20))
        == (b.signal, b.expected(20))
        != (c.signal, c.expected(20))
    )
