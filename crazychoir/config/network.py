"""Builds the simulated network that a swarm file describes."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import msgspec

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import (
    LOSS_EFFECTS,
    ImpairmentRule,
    NetworkPartition,
)
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import EdgeTable, LinkTable, NetworkTable, PartitionTable
from crazychoir.errors import ConfigError

ENDLESS_TIME = 1e9
"""s: end of a partition without an end."""
COMMON_EFFECTS = ("delay", "jitter", "duplicate", "reorder", "bandwidth")
"""Effects with the same name in a swarm file and in the simulated network."""


def impairment_of(config: SwarmConfig) -> Impairment:
    """Return the simulated network of [network], with the swarm's seed."""
    return Impairment(
        config.seed,
        network_rules(config.network),
        network_partitions(config.network, config.ids),
    )


def network_rules(
    network: NetworkTable, more: Mapping[str, float] | None = None
) -> list[ImpairmentRule]:
    """Return the rules of the simulated network: the rule for all edges, then those of single edges.

    An effect of 0 makes no rule in [network]. In [[network.edges]] it replaces the effect of [network].

    network: effects with the names of a swarm file
    more: further effects on all edges, with the names of EdgeEffects, or `burst`; they replace those
        of network
    Raises ConfigError for a burst in `more` without a loss, or too short for it.
    """
    told = dict(more or {})
    if (burst := told.pop("burst", None)) is not None:
        loss = told.pop("loss", network.loss)
        network = msgspec.structs.replace(network, burst=burst, loss=loss)
        require_loss_of_burst(network)
    effects = _nonzero_effects(network) | told
    rules = [ImpairmentRule(effects)] if effects else []
    return rules + [_edge_rule(edge) for edge in network.edges]


def network_partitions(
    network: NetworkTable, ids: Sequence[int]
) -> list[NetworkPartition]:
    """Return a partition for each two groups of each [[network.partitions]].

    ids: all drones of the swarm; drones that no table names form one more group
    """
    return [cut for table in network.partitions for cut in _cuts(table, ids)]


def impairment_changes(link: LinkTable) -> dict[str, float | None]:
    """Return the arguments for `Impairment.update`, with the effects of the link.

    A new loss replaces the old one completely. An effect of 0 is set.
    Raises ConfigError for a burst below 1 or without a loss.
    """
    require_loss_of_burst(link)
    effects = link_effects(link)
    return (
        {**effects} if link.loss is None else {**dict.fromkeys(LOSS_EFFECTS), **effects}
    )


def require_loss_of_burst(link: LinkTable) -> None:
    """Raise ConfigError for a burst without a loss, or shorter than the loss demands."""
    loss = link.loss
    burst = link.burst
    if burst is not None and not (
        burst >= 1.0 and loss is not None and 0.0 < loss < 1.0
    ):
        found = f"{burst:g} with loss {'not given' if loss is None else f'{loss:g}'}"
        raise ConfigError("burst", found, "1 or more, with a loss between 0 and 1")
    link.require_possible_bursts("burst")


def link_effects(link: LinkTable) -> dict[str, float]:
    """Return the effects that are set, with the names of the simulated network.

    A burst becomes a chain of two states that is bad for `burst` messages in a row on average.
    """
    effects: dict[str, float] = {
        name: value
        for name in COMMON_EFFECTS
        if (value := getattr(link, name)) is not None
    }
    if link.loss is None:
        return effects
    if not link.burst:
        return effects | {"loss": link.loss}
    leave = 1.0 / link.burst
    return effects | {
        "p_bad_good": leave,
        "p_good_bad": min(1.0 - leave, leave * link.loss / max(1.0 - link.loss, 1e-9)),
        "loss_bad": 1.0,
    }


def rules_in_words(network: Mapping[str, Any]) -> list[str]:
    """Return the rules of `Impairment.describe` as text, one line for each."""
    lines = [_rule_in_words(rule) for rule in network["rules"]]
    lines += [_partition_in_words(cut) for cut in network["partitions"]]
    return lines or ["nothing: perfect"]


def _rule_in_words(rule: Mapping[str, Any]) -> str:
    """Return a rule as text."""
    scope = ""
    if "edge" in rule:
        scope = (" to " if rule.get("directed") else " and ").join(
            map(str, rule["edge"])
        ) + ": "
    elif "drone" in rule:
        scope = f"drone {rule['drone']}: "
    effects = {
        name: f"{value:g}"
        for name, value in rule.items()
        if name not in ("edge", "drone", "directed")
    }
    if "p_bad_good" in rule:
        worse = rule["p_good_bad"]
        better = rule["p_bad_good"]
        effects = {
            name: text
            for name, text in effects.items()
            if name not in ("p_good_bad", "p_bad_good", "loss_bad")
        }
        effects["loss"] = f"{worse / (worse + better):g} in bursts of {1.0 / better:g}"
    return scope + ", ".join(f"{name} {text}" for name, text in effects.items())


def _partition_in_words(cut: Mapping[str, Any]) -> str:
    """Return a partition as text."""
    a, b = (", ".join(map(str, side)) for side in (cut["a"], cut["b"]))
    until = "the end" if cut["until"] is None else f"{cut['until']:g} s"
    since = f"{cut['since']:g} s after GO" if cut["since"] else "GO"
    return f"{a} apart from {b or 'the others'}, from {since} to {until}"


def _nonzero_effects(link: LinkTable) -> dict[str, float]:
    """Return the effects of the link that are not 0."""
    if link.loss == 0.0:
        link = msgspec.structs.replace(link, loss=None)
    return {name: value for name, value in link_effects(link).items() if value}


def _edge_rule(edge: EdgeTable) -> ImpairmentRule:
    """Return the rule of the edge, or of all edges of a drone."""
    effects = link_effects(edge)
    if edge.source is None or edge.destination is None:
        drone = edge.destination if edge.source is None else edge.source
        return ImpairmentRule(effects, drone=drone)
    return ImpairmentRule(effects, edge=(edge.source, edge.destination), directed=True)


def _cuts(table: PartitionTable, ids: Sequence[int]) -> list[NetworkPartition]:
    """Return a partition for every pair of groups."""
    groups = list(table.groups)
    if rest := tuple(i for i in ids if not any(i in group for group in groups)):
        groups.append(rest)
    until = table.until or ENDLESS_TIME
    return [NetworkPartition(table.at, until, a, b) for a, b in combinations(groups, 2)]
