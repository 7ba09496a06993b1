"""The settings of the simulated network: effects on edges, partitions, and changes of both.

An edge is a pair of drones that exchange messages; a directed edge is one direction of it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from math import inf
from typing import Any, Final

from crazychoir.errors import ConfigError

_CHANCE_RANGE = (0.0, 1.0, "a probability from 0 to 1")
_SECONDS_RANGE = (0.0, 3600.0, "s, from 0 to 3600")
EFFECT_RANGES: Final = {
    "loss": _CHANCE_RANGE,
    "p_good_bad": _CHANCE_RANGE,
    "p_bad_good": _CHANCE_RANGE,
    "loss_bad": _CHANCE_RANGE,
    "delay": _SECONDS_RANGE,
    "jitter": _SECONDS_RANGE,
    "duplicate": _CHANCE_RANGE,
    "reorder": _CHANCE_RANGE,
    "reorder_delay": _SECONDS_RANGE,
    "bandwidth": (0.0, inf, "bytes/s, 0 for no limit"),
    "queue": _SECONDS_RANGE,
}
"""Least value, largest value, and description of each effect."""
SCOPE_KEYS: Final = ("drone", "edge", "directed")
"""Keys that name the edges of a rule."""


@dataclass(frozen=True, slots=True)
class EdgeEffects:
    """All effects on one directed edge."""

    loss: float = 0.0
    """Probability that a message is lost, independently of others."""
    p_good_bad: float = 0.0
    """Probability, for each message, that the burst chain turns bad."""
    p_bad_good: float = 0.0
    """Probability, for each message, that the burst chain turns good."""
    loss_bad: float = 1.0
    """Probability that a message is lost in the bad state."""
    delay: float = 0.0
    """s: delay of every message."""
    jitter: float = 0.0
    """s: uniform, in addition to the delay."""
    duplicate: float = 0.0
    """Probability of a second delivery."""
    reorder: float = 0.0
    """Probability of an additional delay of reorder_delay."""
    reorder_delay: float = 0.05
    """s: additional delay of a reordered message."""
    bandwidth: float = 0.0
    """bytes/s; 0 for no limit."""
    queue: float = 0.5
    """s: longest wait for the bandwidth."""


LOSS_EFFECTS = ("loss", "p_good_bad", "p_bad_good", "loss_bad")
"""Effects that make one model of loss: independent losses, or a chain with bursts."""
NEW_LOSS_EFFECTS = ("loss", "p_good_bad")
"""Effects with which a rule begins a loss model of its own."""


@dataclass(frozen=True)
class ImpairmentRule:
    """Effects on all edges, on those of one drone, or on one edge.

    If several rules cover an edge, a directed edge wins over an edge, an edge over a drone, and a
    drone over all. Among equals the later rule wins. A rule with a loss, or with a chain that turns
    bad, replaces the loss model of the rules that it wins over as a whole.
    Raises ConfigError for wrong values.
    """

    effects: Mapping[str, float] = field(default_factory=dict)
    """{name of a field of EdgeEffects: value}."""
    drone: int | None = None
    """The drone to and from which the effects apply, or None."""
    edge: tuple[int, int] | None = None
    """The edge (source, destination), or None."""
    directed: bool = False
    """True if the edge counts from source to destination only."""

    def __post_init__(self) -> None:
        _check_scope(self)
        for name, value in self.effects.items():
            _check_effect(name, value)
        _check_burst(self.effects)

    @property
    def rank(self) -> int:
        """0 for all, 1 for a drone, 2 for an edge, 3 for a directed edge."""
        if self.drone is not None:
            return 1
        if self.edge is None:
            return 0
        return 2 + self.directed

    @property
    def scope(self) -> tuple[object, ...]:
        """Value that is equal for rules on the same edges."""
        edge = (
            self.edge
            if self.edge is None or self.directed
            else tuple(sorted(self.edge))
        )
        return (self.drone, edge, self.directed)

    def covers(self, source: int, destination: int) -> bool:
        """Return True if this rule applies to messages from `source` to `destination`."""
        if self.drone is not None:
            return self.drone in (source, destination)
        if self.edge is None or self.edge == (source, destination):
            return True
        return not self.directed and self.edge == (destination, source)

    def describe(self) -> dict[str, Any]:
        """Return the rule as the keyword arguments of `Impairment.update`."""
        scope = {
            "drone": self.drone,
            "edge": self.edge,
            "directed": self.directed or None,
        }
        return {
            name: value for name, value in scope.items() if value is not None
        } | dict(self.effects)


@dataclass(frozen=True)
class NetworkPartition:
    """A time in which no message passes between two groups of drones.

    Raises ConfigError for wrong values.
    """

    since: float
    """s since GO: begin."""
    until: float
    """s since GO: end."""
    a: tuple[int, ...]
    """Drones of one group."""
    b: tuple[int, ...] = ()
    """Drones of the other group; empty for all other drones."""

    def __post_init__(self) -> None:
        if not (
            _is_number(self.since)
            and _is_number(self.until)
            and 0.0 <= self.since < self.until
        ):
            raise ConfigError(
                "partition",
                f"since {self.since!r} until {self.until!r}",
                "0 <= since < until, in s",
            )
        if not self.a or not all(_is_id(j) for j in (*self.a, *self.b)):
            raise ConfigError(
                "partition",
                f"a = {self.a}, b = {self.b}",
                "lists of drone ids, a not empty",
            )
        if any(j in self.a for j in self.b):
            raise ConfigError(
                "partition", f"a = {self.a}, b = {self.b}", "no drone on both sides"
            )

    def cuts(self, source: int, destination: int) -> bool:
        """Return True if it separates these two drones."""
        return self._between(source, destination) or self._between(destination, source)

    def describe(self) -> dict[str, Any]:
        """Return the partition in the terms of `Impairment.update`."""
        return asdict(self) | {"until": None if self.until == inf else self.until}

    def _between(self, i: int, j: int) -> bool:
        return i in self.a and (j in self.b if self.b else j not in self.a)


def effects_on_edge(
    rules: Iterable[ImpairmentRule], source: int, destination: int
) -> EdgeEffects:
    """Return the effects of all rules on one edge."""
    effects: dict[str, float] = {}
    for rule in sorted(rules, key=lambda rule: rule.rank):
        if not rule.covers(source, destination):
            continue
        if any(name in rule.effects for name in NEW_LOSS_EFFECTS):
            effects = {
                name: value
                for name, value in effects.items()
                if name not in LOSS_EFFECTS
            }
        effects.update(rule.effects)
    return EdgeEffects(**effects)


def apply_changes(
    rules: tuple[ImpairmentRule, ...],
    partitions: tuple[NetworkPartition, ...],
    changes: Mapping[str, Any],
) -> tuple[tuple[ImpairmentRule, ...], tuple[NetworkPartition, ...]]:
    """Return the rules and partitions after the changes that `Impairment.update` describes.

    Raises ConfigError for wrong names or values.
    """
    _check_names(
        "impairment",
        changes,
        (*EFFECT_RANGES, *SCOPE_KEYS, "clear", "partitions", "cut"),
    )
    if changes.get("clear"):
        rules = ()
        partitions = ()
    if "partitions" in changes:
        partitions = _read_partitions(changes["partitions"])
    if "cut" in changes:
        partitions = tuple(
            dict.fromkeys((*partitions, *_read_partitions([changes["cut"]])))
        )
    edge = changes.get("edge")
    scope = ImpairmentRule(
        drone=changes.get("drone"),
        edge=tuple(edge) if isinstance(edge, list) else edge,
        directed=changes.get("directed", False),
    )
    effects = {name: changes[name] for name in EFFECT_RANGES if name in changes}
    if (
        not effects
        and not any(name in changes for name in ("partitions", "cut"))
        and not changes.get("clear")
    ):
        raise ConfigError(
            "impairment",
            dict(changes),
            "at least one of " + ", ".join(EFFECT_RANGES),
            "Say what to change.",
        )
    return _merge_rules(rules, scope, effects) if effects else rules, partitions


def _merge_rules(
    rules: tuple[ImpairmentRule, ...], scope: ImpairmentRule, effects: Mapping[str, Any]
) -> tuple[ImpairmentRule, ...]:
    """Return the rules after the effects of one scope have changed; None removes an effect."""
    before = next(
        (dict(rule.effects) for rule in rules if rule.scope == scope.scope), {}
    )
    after = {
        name: value
        for name, value in {**before, **effects}.items()
        if value is not None
    }
    others = tuple(rule for rule in rules if rule.scope != scope.scope)
    rule = replace(scope, effects=after)
    return (*others, rule) if after else others


def _read_partitions(entries: Any) -> tuple[NetworkPartition, ...]:
    if not isinstance(entries, list | tuple) or not all(
        isinstance(entry, Mapping) for entry in entries
    ):
        raise ConfigError(
            "impairment: partitions",
            entries,
            "a list of tables with since, until, a, b",
        )
    return tuple(map(_read_partition, entries))


def _read_partition(entry: Mapping[str, Any]) -> NetworkPartition:
    _check_names("partition", entry, [item.name for item in fields(NetworkPartition)])
    a = entry.get("a", ())
    b = entry.get("b", ())
    until = entry.get("until")
    if not isinstance(a, list | tuple) or not isinstance(b, list | tuple):
        raise ConfigError("partition", f"a = {a!r}, b = {b!r}", "lists of drone ids")
    return NetworkPartition(
        entry.get("since", 0.0), inf if until is None else until, tuple(a), tuple(b)
    )


def _check_names(where: str, found: Mapping[str, Any], allowed: Iterable[str]) -> None:
    for name in found:
        if name not in allowed:
            raise ConfigError(where, name, ", ".join(allowed), "Correct the name.")


def _check_scope(rule: ImpairmentRule) -> None:
    """Raise ConfigError if the drone or the edge of a rule is invalid."""
    if rule.drone is not None and (not _is_id(rule.drone) or rule.edge is not None):
        found = f"drone = {rule.drone!r}, edge = {rule.edge!r}"
        raise ConfigError(
            "impairment", found, "a drone's id, or an edge, not both", "Make two rules."
        )
    edge = rule.edge
    if edge is None and rule.directed:
        raise ConfigError(
            "impairment: directed",
            "no edge",
            "with an edge only",
            "Add edge = [source, destination].",
        )
    if edge is not None and not _is_pair(edge):
        raise ConfigError(
            "impairment: edge", edge, "two drone ids, [source, destination]"
        )
    if edge is not None and edge[0] == edge[1]:
        raise ConfigError("impairment: edge", edge, "two different drones")


def _check_effect(name: str, value: Any) -> None:
    if name not in EFFECT_RANGES:
        raise ConfigError(
            "impairment", name, ", ".join(EFFECT_RANGES), "Correct the name."
        )
    low, high, words = EFFECT_RANGES[name]
    if not _is_number(value) or not low <= value < inf or value > high:
        raise ConfigError(f"impairment: {name}", value, words)


def _check_burst(effects: Mapping[str, float]) -> None:
    """Raise ConfigError if the probabilities of the burst chain do not fit together."""
    if ("p_good_bad" in effects) != ("p_bad_good" in effects):
        raise ConfigError(
            "impairment: burst",
            dict(effects),
            "p_good_bad and p_bad_good together",
            "Set both.",
        )
    worse = effects.get("p_good_bad", 0.0)
    better = effects.get("p_bad_good", 0.0)
    if worse > 0.0 and better <= 0.0:
        raise ConfigError(
            "impairment: p_bad_good",
            better,
            "more than 0, or a burst never ends",
            "Use loss = 1.",
        )
    if worse + better > 1.0:
        found = f"p_good_bad + p_bad_good = {worse + better:g}"
        raise ConfigError(
            "impairment: burst",
            found,
            "at most 1",
            "Above it there are no bursts; use loss.",
        )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_pair(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(map(_is_id, value))


def _is_id(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0
