"""What a drone is told, and must answer, before it flies."""

import numpy as np
import pytest
from radio_drones import READY, made, tell
from virtual_time import virtual

from crazychoir.errors import ConfigError
from crazychoir.firmware.release import PROTOCOL_VERSION
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.platforms import CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS
from crazychoir.radio.drone.own_estimate import OwnEstimate
from crazychoir.radio.drone.preparation import Preparation, check_protocol
from crazychoir.radio.protocol.crtp import FIRST_VERSIONS, PACKET_FORMS
from crazychoir.radio.protocol.handlers import RADIO_HANDLERS


class FirmwareOnGround:
    """Firmware that keeps the parameters that are set, and has these decks."""

    def __init__(self, release: str = "2025.12", decks: tuple[str, ...] = ()) -> None:
        self.set_values: list[tuple[str, float]] = []
        self._release = release
        self._decks = decks

    async def release(self) -> str:
        return self._release

    async def has(self, name: str) -> bool:
        return name.removeprefix("deck.") in self._decks

    async def set(self, name: str, value: float) -> None:
        self.set_values.append((name, value))

    async def set_all(self, values: dict[str, float]) -> None:
        self.set_values += values.items()


def make_pair(clock, **radio) -> tuple[Preparation, OwnEstimate]:
    """Return the preparation of a drone without cameras in a swarm of two."""
    drone, _ = made(clock, pose="onboard", **radio)
    row = {"id": 1, "home": [1, 0, 0], "uri": "udp://127.0.0.1:19851"}
    raw = [
        {"id": 0, "home": [0, 0, 0], "uri": "udp://127.0.0.1:19850", "pose": "onboard"},
        row,
    ]
    drone.setup.config = drone.setup.config.of(
        {"name": "a", "drones": raw, "radio": {"log_rate": 50.0} | radio}
    )
    return drone.preparation, drone.estimate


@virtual
async def test_drones_without_a_common_frame_are_refused_unless_drift_is_allowed(
    clock,
) -> None:
    preparation, _ = make_pair(clock)
    with pytest.raises(ConfigError, match="bcFlow2 on board: its frame drifts"):
        await preparation.prepare(FirmwareOnGround(decks=("bcFlow2",)))
    assert not preparation.is_done
    await preparation.prepare(FirmwareOnGround(decks=("bcLighthouse4",)))
    assert preparation.is_done
    preparation, _ = make_pair(clock, drift=True)
    await preparation.prepare(FirmwareOnGround())
    assert preparation.is_done


@virtual
async def test_an_estimator_is_started_at_the_given_pose_but_not_in_flight(
    clock,
) -> None:
    drone, _ = made(clock)
    place = drone.preparation.place
    flying, standing = FirmwareOnGround(), FirmwareOnGround()
    initial = [
        ("kalman.initialX", 1.0),
        ("kalman.initialY", 2.0),
        ("kalman.initialZ", 3.0),
        ("kalman.initialYaw", 0.5),
    ]
    tell(drone, READY | SUPERVISOR_BITS.flying)
    await place(flying, np.array([1.0, 2.0, 3.0]), 0.5)
    assert flying.set_values == initial
    assert not drone.preparation.is_placed
    tell(drone, READY)
    await place(standing, np.array([1.0, 2.0, 3.0]), 0.5)
    reset = [("kalman.resetEstimation", 1), ("kalman.resetEstimation", 0)]
    assert standing.set_values == initial + reset
    assert drone.preparation.is_placed


@virtual
async def test_a_release_of_unknown_thrust_is_refused_on_the_ground_and_lands_in_flight(
    clock,
) -> None:
    drone, _ = made(clock, "fpqr")
    old = FirmwareOnGround("2025.09")
    tell(drone, READY)
    with pytest.raises(ConfigError, match=r"2025\.09"):
        await drone.preparation.check_release(old, None)
    tell(drone, READY | SUPERVISOR_BITS.flying)
    assert "2025.09" in await drone.preparation.check_release(old, None)
    assert drone.preparation.release == ""
    assert await drone.preparation.check_release(FirmwareOnGround(), None) == ""
    assert drone.preparation.release == "2025.12"


@virtual
async def test_a_drone_that_was_started_again_is_prepared_from_the_beginning(
    clock,
) -> None:
    drone, _ = made(clock)
    preparation = drone.preparation
    preparation.release = "2025.12"
    preparation.is_prepared = preparation.is_placed = True
    preparation.forget()
    assert (preparation.release, preparation.is_done) == ("", False)


LEAST_VERSIONS = {"fpqr": -1, "frpy": -1, "vel": 9, "xyz": 8, "fullstate": -1}


@pytest.mark.parametrize("kind", RADIO_HANDLERS)
def test_each_sender_says_what_it_needs(kind: str) -> None:
    for version in range(-1, PROTOCOL_VERSION + 1):
        if version >= LEAST_VERSIONS[kind]:
            check_protocol(version, kind, CRAZYFLIE_21, "drone 3")
        else:
            with pytest.raises(
                ConfigError,
                match=f"{LEAST_VERSIONS[kind]} or newer, for {RADIO_HANDLERS[kind].form}",
            ):
                check_protocol(version, kind, CRAZYFLIE_21, "drone 3")


@pytest.mark.parametrize("kind", RADIO_HANDLERS)
def test_a_drone_that_must_be_armed_needs_protocol_12_with_every_sender(
    kind: str,
) -> None:
    check_protocol(12, kind, CRAZYFLIE_21_BRUSHLESS, "drone 3")
    with pytest.raises(
        ConfigError,
        match=rf"12 or newer, for arm \(sender {kind} on .*\)\. Write newer firmware\.$",
    ):
        check_protocol(11, kind, CRAZYFLIE_21_BRUSHLESS, "drone 3")


def test_the_refusal_says_the_numbers_and_what_to_do() -> None:
    with pytest.raises(ConfigError) as refused:
        check_protocol(8, "vel", CRAZYFLIE_21, "drone 3")
    assert str(refused.value) == (
        "drone 3: protocol of its firmware: found version 8; allowed: 9 or newer, for velocity_world (sender vel on "
        "cf21). Write newer firmware, or choose another sender in [control]: fpqr, frpy, xyz, fullstate."
    )
    with pytest.raises(ConfigError, match="found no version"):
        check_protocol(-1, "xyz", CRAZYFLIE_21, "drone 3")


def test_the_version_table_names_only_known_forms_and_existing_versions() -> None:
    assert FIRST_VERSIONS.keys() <= PACKET_FORMS.keys()
    assert max(FIRST_VERSIONS.values()) == PROTOCOL_VERSION
