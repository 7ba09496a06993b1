"""The survey's probe through cflib's own Crazyradio, on a USB device that is not there."""

import itertools

import numpy as np
import pytest
from cflib.drivers.crazyradio import SET_RADIO_ARC, SET_RADIO_CHANNEL, Crazyradio
from usb.core import USBError

from crazychoir.errors import ConfigError, Refused
from crazychoir.radio.survey.survey import Survey, run_survey
from crazychoir.radio.survey.survey_radio import CrazyradioProbe, open_probe, parse_rssi


class Dongle:
    """A USB device as cflib's driver talks to it, and a drone on the air.

    fails: {channel: each so many-th attempt does not come through}; the answer of hop number `deaf` is lost.
    """

    bcdDevice = 0x0053  # version 0.53

    def __init__(self, home=80, fails=None, deaf=None):
        self.drone, self.fails, self.deaf = home, fails or {}, deaf
        self.safelink, self.counted, self.closed, self.channel, self.arc = (
            True,
            False,
            False,
            2,
            3,
        )
        self.attempts, self.hops, self.sent = itertools.count(1), 0, []
        self._ctx = self

    def set_configuration(self, number):
        pass

    def reset(self):
        pass

    def dispose(self, device):
        self.closed = True

    def ctrl_transfer(
        self, kind, request, wValue, wIndex, timeout, data_or_wLength
    ):  # pyusb's names
        if request == SET_RADIO_CHANNEL:
            self.channel = wValue
        if request == SET_RADIO_ARC:
            self.arc = wValue

    def write(self, endpoint, data, timeout):
        data = tuple(data)
        self.sent.append((self.channel, data))
        for attempt in range(self.arc + 1):
            every = self.fails.get(self.channel)
            if self.channel == self.drone and not (
                every and next(self.attempts) % every == 0
            ):
                heard = self._hears(data)
                self.answer = bytes(
                    [
                        attempt << 4 | 0b11,
                        *([0xF3, 0x01, 48] if len(data) == 1 else data),
                    ]
                )
                if not heard:
                    self.answer = b"\0"
                return
        self.answer = b"\0"

    def _hears(self, data):
        """Return whether the answer comes back."""
        if data == (0xFF, 0x05, 0x00):
            self.safelink = False
        elif data[:3] == (0xFF, 0x03, 0x01):
            if self.safelink and self.counted:
                return True  # acknowledged, and thrown away as a repeated packet
            self.counted, self.drone, self.hops = True, data[3], self.hops + 1
            return self.hops != self.deaf
        return True

    def read(self, endpoint, size, timeout):
        return self.answer


@pytest.fixture
def clock():
    ticks = itertools.count()
    return lambda: 0.001 * next(ticks)


def test_a_survey_on_a_dongle(clock):
    dongle = Dongle(fails={20: 4})
    found = Survey((10, 20), passes=3, packets=40)
    with CrazyradioProbe(Crazyradio(device=dongle), 80, clock) as probe:
        run_survey(found, probe)
        assert dongle.drone in (10, 20)
    good, bad = found.measured()
    assert good.passes == (1.0, 1.0, 1.0)
    assert good.retries == (120, 0, 0, 0, 0)
    assert bad.passes == (0.75, 0.75, 0.75)
    assert bad.retries[0] == pytest.approx(
        80, abs=2
    )  # each third packet meets the fourth attempt
    assert bad.retries[1] == pytest.approx(40, abs=2)
    assert bad.retries[2:] == (0, 0, 0)
    assert good.round_trip == pytest.approx((0.001, 0.001))
    assert good.rssi == (-48.0, 0.0)
    assert dongle.drone == 80
    assert dongle.closed


def test_packets_without_retries_are_sent_once(clock):
    dongle = Dongle(fails={10: 2})
    with CrazyradioProbe(Crazyradio(device=dongle), 80, clock) as probe:
        sample = probe.measure(10, 20, 0)
        assert (dongle.arc, sample.acknowledged.sum(), sample.retries.max()) == (
            0,
            10,
            0,
        )
        assert np.isnan(sample.rssi[~sample.acknowledged]).all()
        assert probe.measure(10, 20, 3).acknowledged.all()
        assert dongle.arc == 3


def test_a_drone_that_hops_without_an_answer_is_found_on_the_new_channel(clock):
    dongle = Dongle(deaf=1)
    with CrazyradioProbe(Crazyradio(device=dongle), 80, clock) as probe:
        assert probe.measure(10, 20, 0).acknowledged.all()
    assert dongle.drone == 80


def test_a_channel_where_nothing_passes_is_measured_as_that_and_the_drone_is_lost_there(
    clock,
):
    dongle = Dongle(fails={10: 1})
    probe = CrazyradioProbe(Crazyradio(device=dongle), 80, clock).__enter__()
    assert not probe.measure(10, 20, 3).acknowledged.any()
    with pytest.raises(
        Refused, match="no answer on channel 10, where it was, nor on 20"
    ):
        probe.measure(20, 20, 3)
    assert len(dongle.sent) < 2000


def test_a_drone_that_is_not_there_is_refused(clock):
    dongle = Dongle(home=60)
    with pytest.raises(Refused, match=r"channel 80: .*no answer"):
        CrazyradioProbe(Crazyradio(device=dongle), 80, clock).__enter__()
    assert dongle.closed


def test_a_dongle_that_is_pulled_out_is_said(clock):
    dongle = Dongle()
    with CrazyradioProbe(Crazyradio(device=dongle), 80, clock) as probe:
        dongle.ctrl_transfer = pulled_out
        with pytest.raises(Refused, match="udev"):
            probe.measure(10, 20, 0)
    assert dongle.closed


def pulled_out(*arguments, **named):
    raise USBError("No such device (it may have been disconnected)", errno=19)


@pytest.mark.parametrize(
    ("answer", "dbm"),
    [
        ((0xF3, 0x01, 48), -48.0),
        ((0xFF, 0x01, 71), -71.0),
        ((0xF3,), None),
        ((0x53, 0x01, 48), None),
        ((), None),
    ],
)
def test_only_an_answer_that_says_nothing_else_has_the_rssi(answer, dbm):
    assert parse_rssi(answer) == dbm or (dbm is None and np.isnan(parse_rssi(answer)))


def test_without_a_dongle_it_says_what_to_do(monkeypatch, clock):
    monkeypatch.setattr(
        "cflib.drivers.crazyradio._find_devices", lambda serial=None: []
    )
    with pytest.raises(Refused, match=r"Cannot find a Crazyradio Dongle\. Plug"):
        open_probe("radio://0/80/2M", clock)
    with pytest.raises(Refused, match="serial"):
        open_probe("radio://ABCDEF0123/80/2M", clock)


@pytest.mark.parametrize("uri", ["udp://1", "radio://0", "radio://0/x"])
def test_what_is_no_address_of_a_radio_is_refused(uri, clock):
    with pytest.raises(ConfigError, match="radio://DONGLE"):
        open_probe(uri, clock)
