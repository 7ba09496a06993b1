"""Builds the simulated network that a swarm file describes."""

from collections.abc import Mapping
from typing import Any

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError

ENDLESS_TIME = 1e9
"""s: end of a partition without an end."""
COMMON_EFFECTS = ("delay", "jitter", "duplicate", "reorder", "bandwidth")
"""Effects with the same name in a swarm file and in the simulated network."""
LOSS_EFFECTS = ("loss", "p_good_bad", "p_bad_good", "loss_bad")
"""Names of the loss model in the simulated network."""


def impairment_of(config: SwarmConfig) -> Impairment:
    """Return the simulated network of [network], with the swarm's seed."""
    table = config.impairment()
    rules = [ImpairmentRule(effects)] if (effects := _effects(table)) else []
    rules += [_edge_rule(edge) for edge in table.get("edges", [])]
    return Impairment(
        config.seed,
        rules,
        [cut for entry in table.get("partitions", []) for cut in _cuts(entry)],
    )


def impairment_changes(options: Mapping[str, float | None]) -> dict[str, float | None]:
    """Return the arguments for `Impairment.update`, from effects with the names of a swarm file.

    A new loss replaces the old one completely.
    Raises ConfigError for a burst below 1 or without a loss.
    """
    loss = options.get("loss")
    burst = options.get("burst")
    if burst is not None and not (
        burst >= 1.0 and loss is not None and 0.0 < loss < 1.0
    ):
        found = f"{burst:g} with loss {'not given' if loss is None else f'{loss:g}'}"
        raise ConfigError("burst", found, "1 or more, with a loss between 0 and 1")
    given: dict[str, float | None] = {
        name: options[name] for name in COMMON_EFFECTS if options.get(name) is not None
    }
    return (
        given
        if loss is None
        else given | dict.fromkeys(LOSS_EFFECTS) | _losses(loss, burst)
    )


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


def _effects(table: dict[str, Any]) -> dict[str, float]:
    effects = {name: float(table[name]) for name in COMMON_EFFECTS if table.get(name)}
    return effects | (
        _losses(float(table["loss"]), table.get("burst")) if table.get("loss") else {}
    )


def _losses(loss: float, burst: float | None) -> dict[str, float]:
    """Return the loss model with the names of the simulated network.

    A burst becomes a chain of two states that is bad for `burst` messages in a row on average.
    """
    if not burst:
        return {"loss": loss}
    leave = 1.0 / float(burst)
    return {
        "p_bad_good": leave,
        "p_good_bad": min(1.0, leave * loss / max(1.0 - loss, 1e-9)),
        "loss_bad": 1.0,
    }


def _edge_rule(entry: dict[str, Any]) -> ImpairmentRule:
    source = entry.get("source")
    destination = entry.get("destination")
    if source is None or destination is None:
        return ImpairmentRule(
            _effects(entry), drone=destination if source is None else source
        )
    return ImpairmentRule(_effects(entry), edge=(source, destination), directed=True)


def _cuts(entry: dict[str, Any]) -> list[NetworkPartition]:
    """Return a partition for every pair of groups."""
    groups = entry["groups"]
    until = entry.get("until") or ENDLESS_TIME
    return [
        NetworkPartition(entry["at"], until, tuple(a), tuple(b))
        for n, a in enumerate(groups)
        for b in groups[n + 1 :]
    ]
