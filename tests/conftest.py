"""What all tests share."""

from collections.abc import Callable
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
REFERENCE_DATA = REPOSITORY.parent / "shared" / "data"


@pytest.fixture(scope="session")
def repository() -> Path:
    """The folder that holds pyproject.toml."""
    return REPOSITORY


@pytest.fixture(scope="session")
def reference_data() -> Callable[[str], Path]:
    """`reference_data("pdvrp")`: a folder of reference data beside the clone; the test is skipped without it."""

    def folder(name: str) -> Path:
        path = REFERENCE_DATA / name
        if not path.is_dir():
            pytest.skip(f"reference data is not part of the repository: no folder {path}")
        return path

    return folder
