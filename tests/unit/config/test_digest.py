"""Digests of swarm files."""

import os
import subprocess
import sys
from pathlib import Path

from squares import square

from crazychoir.config.digest import compute_digest
from crazychoir.config.swarm_config import (
    SwarmConfig,
    default_swarm,
    demo_swarm,
)

ROOT = Path(__file__).parents[3]


def test_digest_counts_what_hosts_must_agree_on() -> None:
    config = square('mission = "formation"')
    same = [
        config.replace(base_port=9000),
        config.replace(network={"loss": 0.5}),
        SwarmConfig.loads(config.dumps()),
        config.replace(seed=3, lost_after=5.0),
    ]
    other = [
        config.replace(seed=4),
        config.replace(graph="path"),
        config.replace(mission="bearing"),
        config.replace(mission_options={"kp": 2}),
        config.replace(drones=config.drones[:3]),
        config.replace(flight={"speed_limit": 0.5}),
    ]
    assert [compute_digest(one) for one in same] == [compute_digest(config)] * len(same)
    assert (
        len(dict.fromkeys(compute_digest(one) for one in [config, *other]))
        == len(other) + 1
    )
    folders = [
        config.replace(mission=f"/{folder}/own.py") for folder in ("home/a", "srv")
    ]
    assert compute_digest(folders[0]) == compute_digest(folders[1])


def test_digest_does_not_depend_on_the_order_of_free_keys_or_the_hash_seed() -> None:
    forward, backward = (
        square().replace(mission_options=o)
        for o in ({"a": 1, "b": 2}, {"b": 2, "a": 1})
    )
    assert compute_digest(forward) == compute_digest(backward)
    program = (
        "from crazychoir.config.digest import compute_digest; "
        "from crazychoir.config.swarm_config import demo_swarm; "
        "print(compute_digest(demo_swarm()))"
    )
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        said = subprocess.run(
            [sys.executable, "-c", program],
            env=environment,
            capture_output=True,
            check=True,
            cwd=ROOT,
        )
        assert said.stdout.decode().strip() == compute_digest(demo_swarm())


def test_option_that_is_too_long_for_a_path_is_a_text():
    made = default_swarm(2).replace(mission_options={"word": "é" * 200})
    assert len(compute_digest(made)) == 16
    assert compute_digest(made) != compute_digest(default_swarm(2))
