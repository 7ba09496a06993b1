"""The simulated network that a swarm file describes."""

from typing import Any

from crazychoir.bus.impairment import Impairment
from crazychoir.bus.rules import Partition, Rule
from crazychoir.swarm.config import SwarmConfig

FOREVER = 1e9


def impairment_of(config: SwarmConfig) -> Impairment:
    """[network] of the swarm file, with the swarm's seed."""
    table = config.impairment()
    rules = [Rule(effects)] if (effects := _effects(table)) else []
    rules += [_edge_rule(edge) for edge in table.get("edges", [])]
    return Impairment(config.seed, rules, [cut for entry in table.get("partitions", []) for cut in _cuts(entry)])


def _effects(table: dict[str, Any]) -> dict[str, float]:
    """Effects by the names of the simulated network; a burst is a chain that is bad for `burst` messages in a row."""
    plain = ("delay", "jitter", "duplicate", "reorder", "bandwidth")
    effects = {name: float(table[name]) for name in plain if table.get(name)}
    loss = float(table.get("loss") or 0.0)
    if loss and table.get("burst"):
        leave = 1.0 / float(table["burst"])
        effects |= {"p_bad_good": leave, "p_good_bad": min(1.0, leave * loss / max(1.0 - loss, 1e-9)), "loss_bad": 1.0}
    elif loss:
        effects["loss"] = loss
    return effects


def _edge_rule(entry: dict[str, Any]) -> Rule:
    source, destination = entry.get("source"), entry.get("destination")
    if source is None or destination is None:
        return Rule(_effects(entry), drone=destination if source is None else source)
    return Rule(_effects(entry), edge=(source, destination), directed=True)


def _cuts(entry: dict[str, Any]) -> list[Partition]:
    """Every pair of groups is cut from each other."""
    groups = entry["groups"]
    until = entry.get("until") or FOREVER
    return [
        Partition(entry["at"], until, tuple(a), tuple(b)) for n, a in enumerate(groups) for b in groups[n + 1 :]
    ]
