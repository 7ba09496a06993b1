"""What all tests share."""

import fcntl
import os
import tempfile
from collections.abc import Callable, Generator
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import settings

# Hypothesis draws equal examples in each run, however slow the machine is: a failure can be repeated.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")
REPOSITORY = Path(__file__).resolve().parents[1]
LAW = "\n@kernel("
REFERENCE_DATA = REPOSITORY.parent / "shared" / "data"


@pytest.hookimpl(trylast=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """On a fresh machine the workers of pytest-xdist compile all laws, one from each end of the list, before any test.

    Otherwise each would wait for the law that the other one compiles, and then for the next one; and what a test
    compiles would count for its timeout.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if not worker:
        return
    laws = [
        compile_routing,
        *(partial(import_module, name) for name in modules_with_laws()),
    ]
    for compile_law in reversed(laws) if int(worker.removeprefix("gw")) % 2 else laws:
        compile_law()


def modules_with_laws() -> list[str]:
    files = sorted((REPOSITORY / "crazychoir").rglob("*.py"))
    return [
        ".".join(file.relative_to(REPOSITORY).with_suffix("").parts)
        for file in files
        if LAW in file.read_text()
    ]


def compile_routing() -> None:
    """The search compiles its laws when they are called, for one trip and for several: nearly half of all compiling."""
    from crazychoir.routing.distributed.plain_loop import compile_routing_kernels
    from crazychoir.routing.instance.generate import random_instance

    for trips in (1, 2):
        compile_routing_kernels(
            replace(random_instance(2, 3, seed=0), recharge=trips).local(0)
        )


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """`-m "real_time ..."` imports the files alone that have such tests: importing all takes many seconds."""
    if (
        not config.option.markexpr.startswith("real_time")
        or collection_path.suffix != ".py"
    ):
        return None
    text = collection_path.read_text()
    named = collection_path.name.startswith("test_") and (
        "real_time" in text or "compiled" in text
    )
    return None if named else True


@pytest.hookimpl(tryfirst=True)  # before `-m` selects by marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark each test that starts agents as processes as `real_time`.

    `make test` runs these tests beside the tests that only compute. In one run they come last: by then the other tests
    have compiled what there is to compile.
    """
    for item in items:
        if _starts_agents(item):
            item.add_marker("real_time")
    items.sort(key=_starts_agents)


def _starts_agents(item: pytest.Item) -> bool:
    return "compiled" in getattr(item, "fixturenames", ())


@pytest.hookimpl(
    wrapper=True, tryfirst=True
)  # the time of waiting is not the test's: outside of its timeout
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Run one real-time test at once on this machine, in all test runs together: others would load its processors."""
    if item.get_closest_marker("real_time") is None:
        return (yield)
    turn = os.open(tempfile.gettempdir(), os.O_RDONLY)
    try:
        fcntl.flock(turn, fcntl.LOCK_EX)
        return (yield)
    finally:
        os.close(turn)


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
            pytest.skip(
                f"reference data is not part of the repository: no folder {path}"
            )
        return path

    return folder
