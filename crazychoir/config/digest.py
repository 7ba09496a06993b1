"""Digests of a swarm file, with which hosts find out that their files differ."""

import hashlib
from pathlib import Path
from typing import Any

import msgspec

from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.file_paths import SHAPE_FILE_KEYS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import AGREED_KEYS, BODY_KEYS, HOST_KEYS
from crazychoir.files.path_texts import json_bytes


def compute_digest(config: SwarmConfig) -> str:
    """Return 16 hex digits that are equal at all hosts of one
    mission, for every Python and hash seed.

    All keys count but `hosts`, `router`, `security`, `base_port` and `network`. Of the mission,
    of shapes and of recordings of poses only the file name counts, not the folder. A file in
    the mission's options counts by its content.
    """
    return hashlib.blake2b(
        json_bytes(_agreed_values(config), order="sorted"), digest_size=8
    ).hexdigest()


def compute_key_digests(config: SwarmConfig) -> str:
    """Return two hex digits for each of the AGREED_KEYS, to
    name the keys in which two files differ.
    """
    agreed = _agreed_values(config)
    said = [json_bytes(agreed[key], order="sorted") for key in AGREED_KEYS]
    return "".join(hashlib.blake2b(value, digest_size=1).hexdigest() for value in said)


def compute_body_digests(config: SwarmConfig) -> dict[str, str]:
    """Return hex digits for each of the BODY_KEYS, equal for equal values.

    No file is read.
    """
    agreed: dict[str, Any] = msgspec.to_builtins(config)
    agreed["mujoco"] |= {
        key: Path(getattr(config.mujoco, key)).name for key in SHAPE_FILE_KEYS
    }
    for drone in agreed["drones"]:
        drone["uri"] = (
            drone["uri"].rpartition("/")[2]
            if drone["uri"].startswith(WORLD_URIS.replay)
            else drone["uri"]
        )
    said = {key: json_bytes(agreed[key], order="sorted") for key in BODY_KEYS}
    return {
        key: hashlib.blake2b(value, digest_size=4).hexdigest()
        for key, value in said.items()
    }


def _agreed_values(config: SwarmConfig) -> dict[str, Any]:
    """Return the plain values that must be equal at all hosts, with
    the content of files instead of their paths.
    """
    agreed = {
        key: value
        for key, value in msgspec.to_builtins(config).items()
        if key not in HOST_KEYS
    }
    agreed["mission"] = Path(config.mission or "").name
    agreed["mujoco"] |= {
        key: Path(getattr(config.mujoco, key)).name for key in SHAPE_FILE_KEYS
    }
    agreed["mocap"]["file"] = Path(config.mocap.file).name
    agreed["mission_options"] = {
        key: _content(value) for key, value in config.mission_options.items()
    }
    for drone in agreed["drones"]:
        name, mark, number = drone["uri"].removeprefix(WORLD_URIS.replay).partition("?")
        drone["uri"] = (
            drone["uri"]
            if name == drone["uri"]
            else f"{WORLD_URIS.replay}{_content(name)}{mark}{number}"
        )
    return agreed


def _content(value: Any) -> Any:
    """Return the hash of a file's content if the value is its path, else the value."""
    if not isinstance(value, str) or len(value) > 1000 or not _is_file(value):
        return value
    return hashlib.blake2b(Path(value).read_bytes(), digest_size=8).hexdigest()


def _is_file(text: str) -> bool:
    """Return whether a text is the path of a file; a text may be too long for a path."""
    try:
        return Path(text).is_file()
    except (OSError, ValueError):
        return False
