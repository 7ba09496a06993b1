"""Effects as a swarm file and `crazychoir impair` name them, and as the simulated network does."""

import pytest

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import (
    EdgeEffects,
    ImpairmentRule,
    NetworkPartition,
    effects_on_edge,
)
from crazychoir.config.network import (
    ENDLESS_TIME,
    impairment_changes,
    impairment_of,
    network_partitions,
    network_rules,
    rules_in_words,
)
from crazychoir.config.swarm_config import default_swarm
from crazychoir.config.tables import (
    EdgeTable,
    LinkTable,
    NetworkTable,
    PartitionTable,
)
from crazychoir.errors import ConfigError

BURSTS_OF_TWO = EdgeEffects(p_bad_good=0.5, p_good_bad=0.5)
"""Half of the messages are lost, two in a row on average."""


def test_rules_come_from_the_effects_that_are_set():
    network = NetworkTable(
        loss=0.25,
        burst=5.0,
        delay=0.0,
        edges=(
            EdgeTable(source=0, destination=1, jitter=0.1),
            EdgeTable(source=2, loss=1.0),
            EdgeTable(destination=3, bandwidth=100.0),
        ),
    )
    chain = {"p_bad_good": 0.2, "p_good_bad": 0.2 * 0.25 / 0.75, "loss_bad": 1.0}
    assert network_rules(network) == [
        ImpairmentRule(chain),
        ImpairmentRule({"jitter": 0.1}, edge=(0, 1), directed=True),
        ImpairmentRule({"loss": 1.0}, drone=2),
        ImpairmentRule({"bandwidth": 100.0}, drone=3),
    ]
    assert network_rules(NetworkTable(loss=0.0)) == []


@pytest.mark.parametrize(
    ("edge", "effects"),
    [
        ({"loss": 0.0}, EdgeEffects(delay=0.1)),
        ({"loss": 0.5}, EdgeEffects(loss=0.5, delay=0.1)),
        ({"delay": 0.0, "loss": 0.0}, EdgeEffects()),
        ({"loss": 0.5, "burst": 2.0, "delay": 0.0}, BURSTS_OF_TWO),
    ],
)
def test_the_effects_of_an_edge_replace_those_of_the_network(edge, effects):
    network = NetworkTable(
        loss=0.25,
        burst=5.0,
        delay=0.1,
        edges=(EdgeTable(source=0, destination=1, **edge),),
    )

    assert effects_on_edge(network_rules(network), 0, 1) == effects


def test_a_new_loss_of_an_edge_replaces_the_bursts_of_the_running_network():
    running = Impairment(0, network_rules(NetworkTable(loss=0.25, burst=5.0)))

    running.update(
        impairment_changes(LinkTable(loss=0.5)) | {"edge": (0, 1), "directed": True}
    )

    assert effects_on_edge(running.rules, 0, 1) == EdgeEffects(loss=0.5)
    assert effects_on_edge(running.rules, 1, 0).p_bad_good == 0.2


def test_an_effect_that_is_unset_gives_way_to_the_rule_for_all():
    running = Impairment(0, [ImpairmentRule({"loss": 0.3})])
    running.update({"drone": 2, "p_good_bad": 0.1, "p_bad_good": 0.2, "loss_bad": 0.9})

    running.update({"drone": 2, "p_good_bad": None, "p_bad_good": None})

    assert effects_on_edge(running.rules, 2, 0).loss == 0.3


@pytest.mark.parametrize(
    ("edge", "words"),
    [
        ({"loss": 0.0}, "0 to 1: loss 0"),
        ({"loss": 0.5}, "0 to 1: loss 0.5"),
        ({"loss": 0.5, "burst": 2.0}, "0 to 1: loss 0.5 in bursts of 2"),
    ],
)
def test_the_rule_of_an_edge_is_shown_in_words(edge, words):
    network = NetworkTable(edges=(EdgeTable(source=0, destination=1, **edge),))

    shown = rules_in_words(Impairment(0, network_rules(network)).describe())

    assert shown == [words]


def test_further_effects_replace_those_of_the_table():
    rules = network_rules(NetworkTable(loss=0.5, delay=0.001), {"delay": 0.0})
    assert rules == [ImpairmentRule({"loss": 0.5, "delay": 0.0})]


def test_partitions_name_every_drone():
    cut = PartitionTable(at=2.0, groups=((1,),))
    assert network_partitions(NetworkTable(partitions=(cut,)), range(4)) == [
        NetworkPartition(2.0, ENDLESS_TIME, (1,), (0, 2, 3))
    ]
    whole = PartitionTable(at=2.0, until=3.0, groups=((1, 0), (2, 3)))
    assert network_partitions(NetworkTable(partitions=(whole,)), range(4)) == [
        NetworkPartition(2.0, 3.0, (1, 0), (2, 3))
    ]
    three = PartitionTable(at=2.0, until=3.0, groups=((0,), (1,)))
    assert network_partitions(NetworkTable(partitions=(three,)), range(3)) == [
        NetworkPartition(2.0, 3.0, a, b)
        for a, b in [((0,), (1,)), ((0,), (2,)), ((1,), (2,))]
    ]


def test_a_running_network_takes_what_a_file_would_say():
    link = {"loss": 0.25, "burst": 5.0, "delay": 0.1}
    running = Impairment(0)
    running.update(impairment_changes(LinkTable(**link, jitter=None)))
    assert running.rules == impairment_of(default_swarm(2).replace(network=link)).rules
    running.update(impairment_changes(LinkTable(loss=0.5)))
    assert [rule.describe() for rule in running.rules] == [
        {"delay": 0.1, "loss": 0.5}
    ], "no bursts any more"


@pytest.mark.parametrize(
    "options",
    [{"burst": 5.0}, {"burst": 0.5, "loss": 0.1}, {"burst": 2.0, "loss": 0.0}],
)
def test_a_burst_is_of_a_loss(options):
    with pytest.raises(ConfigError, match="1 or more, with a loss between 0 and 1"):
        impairment_changes(LinkTable(**options))


def test_a_burst_shorter_than_its_loss_demands_is_refused_in_flight():
    with pytest.raises(ConfigError, match=r"too short for loss = 0\.9"):
        impairment_changes(LinkTable(loss=0.9, burst=9.0))
    assert impairment_changes(LinkTable(loss=0.75, burst=4.0))["p_good_bad"] == 0.75


def test_a_loss_from_the_command_line_must_suit_the_bursts_of_the_file():
    bursts = default_swarm(2).replace(network={"loss": 0.1, "burst": 4.0})

    assert bursts.with_network(loss=0.0).network.loss == 0.0
    with pytest.raises(
        ConfigError, match=r"network\.burst = 4\.0: too short for loss = 0\.9"
    ):
        bursts.with_network(loss=0.9)
    with pytest.raises(ConfigError, match=r"network\.burst = 3\.0: no loss is given"):
        default_swarm(2).with_network(burst=3.0)


def test_a_change_may_set_an_effect_to_zero():
    running = Impairment(0, network_rules(NetworkTable(loss=0.3, delay=0.1)))
    running.update(impairment_changes(LinkTable(loss=0.0, delay=0.0)))
    assert running.rules == (ImpairmentRule({"loss": 0.0, "delay": 0.0}),)
