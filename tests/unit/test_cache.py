import dis
import os
import runpy
import subprocess
import sys
import types
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest

import crazychoir.filters.kalman
import crazychoir.simulation.crazyflies  # noqa: F401 - their kernels, and all that they import, are looked at
from crazychoir import cache
from crazychoir.cache import Kept, Untold
from crazychoir.math3d import clip, kernel

PIECES = """
from crazychoir.math3d import kernel
FACTOR = 3.0

@kernel()
def scaled(x):
    return FACTOR * x
"""
LAW = """
import numba
import pieces
from crazychoir.math3d import kernel

@kernel(numba.float64)
def law(x):
    return pieces.scaled(x) + 1.0

missed = len(law.stats.cache_misses) + len(pieces.scaled.stats.cache_misses)
print(law(2.0), missed, law.stats.cache_path)
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "pieces.py").write_text(PIECES)
    (tmp_path / "law.py").write_text(LAW)
    return tmp_path


def run(folder, **environment):
    """The law's answer in a process of its own, how much was compiled for it, and where that is kept."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **environment}
    answer = subprocess.run([sys.executable, folder / "law.py"], env=environment, capture_output=True, check=True)
    result, missed, place = answer.stdout.decode().split()
    return float(result), int(missed), place


def test_of_processes_that_start_together_one_compiles(folder):
    (folder / "pieces.py").write_text(PIECES + "\nimport time\ntime.sleep(0.5)  # so that all have begun\n")
    with ThreadPoolExecutor(3) as pool:
        answers = list(pool.map(lambda _: run(folder), range(3)))
    assert [result for result, *_ in answers] == [7.0] * 3
    assert sum(missed for _, missed, _ in answers) == 2, "law and piece, once each"
    assert not list(folder.rglob("*.turn"))


def test_a_turn_ends_when_compiling_is_broken_off(folder, monkeypatch):
    """After a test's timeout it held the turn for ever: the others waited for it, and its process for itself."""
    law, turns = runpy.run_path(folder / "pieces.py")["scaled"], []

    def alarm(*_types):
        turns.extend(folder.rglob("*.turn"))
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(law._compiler, "compile", alarm)
        with pytest.raises(KeyboardInterrupt):
            law(2.0)
    assert len(turns) == 1
    assert not turns[0].exists()
    assert law(2.0) == 6.0


def test_who_waits_is_told_that_it_compiles_once_though_standard_error_is_no_terminal(folder):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    said = [subprocess.run([sys.executable, folder / "law.py"], env=environment, capture_output=True, check=True).stderr
            for _ in range(2)]  # fmt: skip
    assert said == [f"{cache.COMPILES}\n".encode(), b""]


def test_comments_docstrings_and_times_compile_nothing_and_a_constant_of_another_file_what_names_it(folder):
    assert run(folder)[:2] == (7.0, 2)
    law = LAW.replace("(x):\n", '(x):\n    """Thrice, and one."""\n')
    (folder / "law.py").write_text("# Said anew.\n\n" + law)
    os.utime(folder / "pieces.py", (0, 0))
    assert run(folder)[:2] == (7.0, 0)
    (folder / "pieces.py").write_text(PIECES.replace("3.0", "5.0"))
    assert run(folder)[:2] == (11.0, 2)
    kept = [path.name for path in (folder / "__pycache__").glob("*.nb[ic]")]
    assert len(kept) == 4, "what nobody reads any more is removed"


def test_what_is_compiled_is_kept_where_numba_is_told_to(folder, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    assert run(folder, NUMBA_CACHE_DIR=str(elsewhere))[2].startswith(str(elsewhere))
    assert run(folder, NUMBA_CACHE_DIR=str(elsewhere))[1] == 0
    assert not list(folder.glob("__pycache__/*.nbi"))


def law_of(source, **names):
    exec(source, names)  # noqa: S102 - as a module of these names would
    return names["law"]


def digest(source, *options, **names):
    return Kept(law_of(source, **names), *options).digest


NAMES = "def law(x, y=2.0): return K * x + y"
RECORD = np.dtype([("a", np.float64), ("b", np.int64)])


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (3.0, 4.0),
        (3.0, 3),
        (0.0, -0.0),
        ((1.0, (2.0, 3.0)), (1.0, (2.0, 4.0))),
        (np.float64(3.0), np.float32(3.0)),
        (np.arange(3.0), np.arange(3.0) + 1e-15),
        (np.arange(4.0), np.arange(4.0).reshape(2, 2)),
        (RECORD, np.dtype([("a", np.float64), ("c", np.int64)])),
        (numba.float64, numba.float32),
        (kernel()(lambda x: x), kernel()(lambda x: -x)),
        (numba.njit(lambda x: x / 2), numba.njit(lambda x: x / 3)),
        (numba.njit(lambda x: x), numba.njit(fastmath=True)(lambda x: x)),
        (min, max),
        ("one", b"one"),
    ],
)
def test_what_a_law_names_is_part_of_it(one, other):
    assert digest(NAMES, K=one) == digest(NAMES, K=one)
    assert digest(NAMES, K=one) != digest(NAMES, K=other)


def test_so_are_its_own_code_its_defaults_and_how_it_is_compiled():
    same = digest(NAMES, K=1.0)
    assert digest(NAMES.replace("+", "-"), K=1.0) != same
    assert digest(NAMES.replace("2.0", "2.5"), K=1.0) != same
    assert digest(NAMES, "fast", K=1.0) != same


def test_so_is_what_it_encloses():
    def made(k):
        return Kept(lambda x: k * x).digest

    assert made(2.0) == made(2.0) != made(3.0)


def test_through_modules():
    def module(k):
        made = types.ModuleType("made")
        made.k, made.other = k, k
        return made

    source = "def law(x): return made.k * x"
    assert digest(source, made=module(2.0)) != digest(source, made=module(3.0))


@pytest.mark.parametrize("unknown", [object(), [1.0], types.ModuleType("m"), lambda x: x, np.array([{}])])
def test_a_law_that_names_what_has_no_digest_is_not_kept(unknown):
    law = law_of(NAMES, K=unknown)
    with pytest.raises(Untold):
        _ = Kept(law).digest
    assert Kept(law).cache_path is None


def test_nor_is_one_that_names_what_is_not_there_or_itself():
    with pytest.raises(Untold):
        digest(NAMES)
    both = kernel()(law_of("def law(x): return law(x)"))
    both.py_func.__globals__["law"] = both
    with pytest.raises(Untold):
        _ = both._cache.digest


def test_all_kernels_of_the_package_are_kept():
    laws = [law for _, law in kernels()]
    assert len(laws) > 100
    for law in laws:
        assert len(law._cache.digest) == 32


def test_names_are_found_as_dis_finds_them():
    for name, law in [*kernels(), ("clip", clip)]:
        assert cache._paths(law.py_func.__code__) == by_dis(law.py_func.__code__), name
    many = "def law(x): return " + " + ".join(f"m{k}.a.b{k}(x) + c{k}" for k in range(300))
    assert cache._paths(law_of(many).__code__) == by_dis(law_of(many).__code__)


def kernels():
    """Of the modules imported above."""
    for module in [module for name, module in sys.modules.items() if name.startswith("crazychoir.")]:
        for name, law in vars(module).items():
            if isinstance(getattr(law, "_cache", None), Kept):
                yield f"{module.__name__}.{name}", law


def by_dis(code):
    paths, inside = [], False
    for step in dis.get_instructions(code):
        if step.opname == "LOAD_GLOBAL":
            paths.append([step.argval])
            inside = True
        elif inside and step.opname in ("LOAD_ATTR", "LOAD_METHOD"):
            paths[-1].append(step.argval)
        elif step.opname != "EXTENDED_ARG":
            inside = False
    return paths
