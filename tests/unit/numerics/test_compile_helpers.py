"""Processes that help to compile laws."""

import os
import time

import pytest

from crazychoir.numerics import compile_helpers
from crazychoir.numerics.compile_helpers import share_laws

LAW = """
@kernel(real)
def law_{number}(x):
    return x + {number}.5
"""
NAMES = [("many_laws", f"law_{number}") for number in range(8)]


@pytest.fixture
def many_laws(tmp_path, monkeypatch):
    """Write a module with laws that are kept nowhere, and return the folder that keeps them."""
    text = "".join(LAW.format(number=number) for number in range(len(NAMES)))
    (tmp_path / "many_laws.py").write_text(
        "from crazychoir.numerics.kernels import kernel, real\n" + text
    )
    before = os.environ.get("PYTHONPATH", "")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{before}")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    return tmp_path / "kept"


def have_processors(monkeypatch, count):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(count)))


def list_kept(folder):
    return {file.name.split("-")[0] for file in folder.rglob("*.nbi")}


def test_helper_compiles_the_laws_that_are_left(many_laws, monkeypatch):
    have_processors(monkeypatch, 2)
    with share_laws(NAMES) as next_law:
        began = time.monotonic()
        while len(list_kept(many_laws)) < len(NAMES):
            assert time.monotonic() - began < 60.0
            time.sleep(0.05)
        assert next_law() is None
    assert list_kept(many_laws) == {f"many_laws.{law}" for _, law in NAMES}


def test_one_processor_takes_all_laws_itself(monkeypatch):
    have_processors(monkeypatch, 1)
    monkeypatch.setattr(compile_helpers, "_start_helper", None)
    with share_laws(NAMES) as next_law:
        taken = [next_law() for _ in range(len(NAMES) + 1)]
    assert taken == [*range(len(NAMES)), None]


def test_few_laws_are_not_shared(monkeypatch):
    have_processors(monkeypatch, 2)
    monkeypatch.setattr(compile_helpers, "_start_helper", None)
    with share_laws(NAMES[:3]) as next_law:
        assert [next_law() for _ in range(4)] == [0, 1, 2, None]


def test_helper_ends_with_an_interrupted_process(many_laws, monkeypatch):
    have_processors(monkeypatch, 2)
    started = []
    start = compile_helpers._start_helper
    monkeypatch.setattr(
        compile_helpers,
        "_start_helper",
        lambda pipe, names: started.append(start(pipe, names)) or started[-1],
    )
    with pytest.raises(KeyboardInterrupt), share_laws(NAMES):
        raise KeyboardInterrupt
    (helper,) = started
    assert helper.returncode is not None
