"""The health tests of the firmware: vibration of each propeller, and sag of the battery under load.

During a test the estimator, the commander and the controllers rest, and the motors turn even if the
supervisor forbids them. Vibrations are not modelled, so the variances are those of the noise and of
the motion of the body.

Source: crazyflie-firmware, health.c, motors.c and platform_defaults.h.
"""

from typing import NamedTuple

from crazychoir.numerics.kernels import kernel
from crazychoir.simulation.onboard.record import Record


class HealthStates(NamedTuple):
    """States of the health tests."""

    done: int = 0
    """No test runs."""
    noise: int = 1
    """The accelerometer is measured with all motors off."""
    propellers: int = 2
    """Each motor turns in turn."""
    battery: int = 3
    """All motors turn at once."""


HEALTH_STATES = HealthStates()


class HealthSettings(NamedTuple):
    """Figures of the health tests that do not depend on the platform."""

    samples: int = 100
    """Samples of the accelerometer for a variance."""
    battery_ticks: int = 50
    """ms for which all motors turn."""
    most_sag: float = 0.7
    """V: a battery that sags more fails the test."""
    finished_bit: int = 128
    """Bit of the result that tells the end of the test of the propellers."""


HEALTH_SETTINGS = HealthSettings()


@kernel()
def _set_motors(fw: Record, ratio: float) -> None:
    for k in range(4):
        fw.ratio[k] = ratio


@kernel()
def _clear_samples(h: Record) -> None:
    h.sum_x = h.sum_y = h.square_x = h.square_y = 0.0


@kernel()
def _add_sample(h: Record, x: float, y: float) -> None:
    h.sum_x += x
    h.sum_y += y
    h.square_x += x * x
    h.square_y += y * y


@kernel()
def _begin(fw: Record) -> None:
    """Begin the test that a parameter asks for, the test of the propellers first."""
    h = fw.health
    h.tick = 0
    if fw.start_propellers:
        fw.start_propellers = 0
        fw.test_state = HEALTH_STATES.noise
        h.motor = 0
        h.passed = 0
        _set_motors(fw, 0.0)
    else:
        fw.start_battery = 0
        fw.test_state = HEALTH_STATES.battery
        h.battery_passed = 0
        h.idle_voltage = fw.vbat
        h.least_voltage = fw.vbat
    _clear_samples(h)


@kernel()
def _end_propellers(fw: Record) -> None:
    """Compare the variances with the thresholds, if there is an upper one."""
    h = fw.health
    for k in range(4):
        total = h.variance_x[k] + h.variance_y[k]
        if h.most != 0.0 and h.least <= total <= h.most:
            h.passed |= 1 << k
    h.passed |= HEALTH_SETTINGS.finished_bit
    h.count += 1
    fw.test_state = HEALTH_STATES.done


@kernel()
def _test_propellers(fw: Record, x: float, y: float) -> None:
    """Let one motor turn for a time, and write the variances of the accelerometer, in g2.

    variance = sum a^2 - (sum a)^2 / n
    """
    h = fw.health
    k = h.motor
    sample = h.tick - h.sample_start
    n = HEALTH_SETTINGS.samples
    if 0 <= sample < n:
        _add_sample(h, x, y)
    elif sample == n:
        h.variance_x[k] = h.square_x - h.sum_x * h.sum_x / n
        h.variance_y[k] = h.square_y - h.sum_y * h.sum_y / n
    h.tick += 1
    if h.tick == 1:
        fw.ratio[k] = (
            h.propeller_ratio if h.propeller_ratio > 0.0 else h.usual_propeller_ratio
        )
    elif h.tick == h.on_ticks:
        fw.ratio[k] = 0.0
    elif h.tick >= h.on_ticks + h.off_ticks:
        h.tick = 0
        h.motor = k + 1
        _clear_samples(h)
        if h.motor == 4:
            _end_propellers(fw)


@kernel()
def _test_battery(fw: Record) -> None:
    """Let all motors turn for a time, and write the sag of the battery, V."""
    h = fw.health
    if h.tick == 1:
        _set_motors(
            fw, h.battery_ratio if h.battery_ratio > 0.0 else h.usual_battery_ratio
        )
    elif h.tick < HEALTH_SETTINGS.battery_ticks:
        h.least_voltage = min(h.least_voltage, fw.vbat)
    else:
        _set_motors(fw, 0.0)
        h.sag = h.idle_voltage - h.least_voltage
        h.battery_passed = 1 if h.sag <= HEALTH_SETTINGS.most_sag else 0
        fw.test_state = HEALTH_STATES.done
    h.tick += 1


@kernel()
def run_test(fw: Record, x: float, y: float) -> None:
    """Run 1 ms of the health test that runs or is asked for.

    x, y: g: accelerometer, not filtered
    """
    if fw.start_propellers or fw.start_battery:
        _begin(fw)
    if fw.test_state == HEALTH_STATES.noise:
        fw.health.tick += 1
        if fw.health.tick >= HEALTH_SETTINGS.samples:
            fw.health.tick = 0
            fw.test_state = HEALTH_STATES.propellers
    elif fw.test_state == HEALTH_STATES.propellers:
        _test_propellers(fw, x, y)
    else:
        _test_battery(fw)
