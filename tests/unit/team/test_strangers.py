"""Which drones have another mission, and which of two camps is refused."""

from crazychoir.config.digest import compute_digest, compute_key_digests
from crazychoir.config.swarm_config import default_swarm
from crazychoir.config.tables import AGREED_KEYS
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.team.strangers import (
    MISSION_CODE_NAME,
    SETTLE_TIME,
    Strangers,
    differing_keys,
)


def told(story) -> None:
    async def main(clock: Clock) -> None:
        await story(clock)

    run_virtual(main)


def test_the_smaller_camp_is_refused_and_of_equals_the_one_without_the_lowest_id():
    async def story(clock: Clock) -> None:
        camp = Strangers(clock, 1, 4, "ours")
        assert not camp.are_more([])
        assert camp.heard(2, "other")
        assert not camp.heard(3, "ours")
        assert not camp.are_more([3])
        assert camp.heard(0, "other")
        assert camp.are_more([3]), "two and two, and 0 is theirs"
        assert camp.heard(0, "third")
        assert not camp.are_more([3])

    told(story)


def test_a_drone_that_changes_to_our_mission_is_a_stranger_no_more():
    async def story(clock: Clock) -> None:
        camp = Strangers(clock, 1, 2, "ours")
        camp.heard(0, "other")
        assert camp.are_more([])
        assert camp.text().startswith(
            "its swarm file or mission (ours) is not that of drone 0 (other). Copy one"
        )
        assert not camp.heard(0, "ours")
        assert camp.missions == {}
        assert not camp.are_more([0])

    told(story)


def test_a_drone_that_has_not_heard_all_others_waits_before_it_judges():
    async def story(clock: Clock) -> None:
        camp = Strangers(clock, 1, 9, "ours")
        camp.heard(0, "other")
        assert not camp.are_more([])
        await clock.sleep(SETTLE_TIME + 0.01)
        assert camp.are_more([])

    told(story)


def test_it_is_told_in_which_keys_of_the_swarm_file_and_whether_in_the_mission_itself_they_differ():
    config = default_swarm(3)

    def hashed(config, code="00"):
        return f"{compute_digest(config)}:{compute_key_digests(config)}{code}"

    other = config.replace(
        graph="complete",
        flight={"speed_limit": 2.0},
        base_port=8000,
        network={"loss": 0.5},
    )
    assert differing_keys(hashed(config), hashed(config), AGREED_KEYS) == []
    assert differing_keys(hashed(config), hashed(other), AGREED_KEYS) == [
        "graph",
        "flight",
    ]
    assert differing_keys(hashed(config), hashed(config, "01"), AGREED_KEYS) == [
        MISSION_CODE_NAME
    ]
    assert differing_keys(hashed(config), hashed(config)[:-2], AGREED_KEYS) == [], (
        "of another version, with other keys"
    )
    assert differing_keys(hashed(config), "ours", AGREED_KEYS) == []

    async def story(clock: Clock) -> None:
        camp = Strangers(clock, 1, 2, hashed(config), AGREED_KEYS)
        assert not camp.heard(0, compute_digest(config)), (
            "after GO only the whole is said"
        )
        assert camp.heard(0, hashed(other))
        here = compute_digest(config)
        there = compute_digest(other)
        whole = f"({here}) is not that of drone 0 ({there}, which has another graph, flight). Copy"
        assert whole in camp.text()

    told(story)
