import dis
import errno
import itertools
import os
import pickle
import runpy
import subprocess
import sys
import types
from concurrent.futures import ThreadPoolExecutor
from enum import IntEnum
from pathlib import Path
from tempfile import TemporaryDirectory

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from other_user import as_user, homeless, in_own_namespace

import crazychoir.filters.kalman
import crazychoir.simulation.motor_level.crazyflies  # noqa: F401 - their kernels, and all that they import, are looked at
from crazychoir.numerics import kernel_cache as cache
from crazychoir.numerics.kernel_cache import LawCache, UnknownDigest, _LawFiles
from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import clip

PIECES = """
from crazychoir.numerics.kernels import kernel
FACTOR = 3.0

@kernel()
def scaled(x):
    return FACTOR * x
"""
LAW = """
import numba
import pieces
from crazychoir.numerics.kernels import kernel

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
    answer = subprocess.run(
        [sys.executable, folder / "law.py"],
        env=environment,
        capture_output=True,
        check=True,
    )
    result, missed, place = answer.stdout.decode().split()
    return float(result), int(missed), place


def test_one_of_several_processes_that_start_together_compiles(folder):
    (folder / "pieces.py").write_text(
        PIECES + "\nimport time\ntime.sleep(0.5)  # so that all have begun\n"
    )
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


def test_the_user_is_told_once_that_it_compiles_even_without_a_terminal(
    folder,
):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    said = [
        subprocess.run(
            [sys.executable, folder / "law.py"],
            env=environment,
            capture_output=True,
            check=True,
        ).stderr
        for _ in range(2)
    ]
    assert said == [f"{cache.COMPILING_MESSAGE}\n".encode(), b""]


def test_comments_docstrings_and_times_compile_nothing_and_a_constant_of_another_file_what_names_it(
    folder,
):
    assert run(folder)[:2] == (7.0, 2)
    law = LAW.replace("(x):\n", '(x):\n    """Thrice, and one."""\n')
    (folder / "law.py").write_text("# Said anew.\n\n" + law)
    os.utime(folder / "pieces.py", (0, 0))
    assert run(folder)[:2] == (7.0, 0)
    (folder / "pieces.py").write_text(PIECES.replace("3.0", "5.0"))
    assert run(folder)[:2] == (11.0, 2)
    kept = [path.name for path in (folder / "__pycache__").glob("*.nb[ic]")]
    assert len(kept) == 4, "files that no run reads any more are removed"


def test_what_is_compiled_is_kept_where_numba_is_told_to(folder, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    assert run(folder, NUMBA_CACHE_DIR=str(elsewhere))[2].startswith(str(elsewhere))
    assert run(folder, NUMBA_CACHE_DIR=str(elsewhere))[1] == 0
    assert not list(folder.glob("__pycache__/*.nbi"))


def law_of(source, **names):
    exec(source, names)  # noqa: S102 - as a module of these names would
    return names["law"]


def digest(source, *options, **names):
    return LawCache(law_of(source, **names), *options).digest


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
        (IntEnum("Kind", "A B"), IntEnum("Kind", "B A")),
    ],
)
def test_what_a_law_names_is_part_of_it(one, other):
    assert digest(NAMES, K=one) == digest(NAMES, K=one)
    assert digest(NAMES, K=one) != digest(NAMES, K=other)


def test_its_own_code_its_defaults_and_how_it_is_compiled_are_part_of_a_law():
    same = digest(NAMES, K=1.0)
    assert digest(NAMES.replace("+", "-"), K=1.0) != same
    assert digest(NAMES.replace("2.0", "2.5"), K=1.0) != same
    assert digest(NAMES, "fast", K=1.0) != same


def test_what_a_law_encloses_is_part_of_it():
    def made(k):
        return LawCache(lambda x: k * x).digest

    assert made(2.0) == made(2.0) != made(3.0)


def test_through_modules():
    def module(k):
        made = types.ModuleType("made")
        made.k, made.other = k, k
        return made

    source = "def law(x): return made.k * x"
    assert digest(source, made=module(2.0)) != digest(source, made=module(3.0))


def test_slices_among_the_constants_count():
    whole, half = (digest(NAMES, K=part) for part in (slice(None), slice(None, 3)))
    assert whole != half


@pytest.mark.parametrize(
    "unknown", [object(), [1.0], types.ModuleType("m"), lambda x: x, np.array([{}])]
)
def test_a_law_that_names_what_has_no_digest_is_not_kept(unknown):
    law = law_of(NAMES, K=unknown)
    with pytest.raises(UnknownDigest):
        _ = LawCache(law).digest
    assert LawCache(law).cache_path is None


def test_a_law_that_names_itself_or_an_unknown_name_has_no_digest():
    with pytest.raises(UnknownDigest):
        digest(NAMES)
    both = kernel()(law_of("def law(x): return law(x)"))
    both.py_func.__globals__["law"] = both
    with pytest.raises(UnknownDigest):
        _ = both._cache.digest


def test_all_kernels_of_the_package_are_kept():
    laws = [law for _, law in kernels()]
    assert len(laws) > 100
    for law in laws:
        assert len(law._cache.digest) == 32


def test_names_are_found_as_dis_finds_them():
    for name, law in [*kernels(), ("clip", clip)]:
        assert cache._global_paths(law.py_func.__code__) == by_dis(
            law.py_func.__code__
        ), name
    many = "def law(x): return " + " + ".join(
        f"m{k}.a.b{k}(x) + c{k}" for k in range(300)
    )
    assert cache._global_paths(law_of(many).__code__) == by_dis(law_of(many).__code__)


def kernels():
    """Of the modules imported above."""
    for module in [
        module for name, module in sys.modules.items() if name.startswith("crazychoir.")
    ]:
        for name, law in vars(module).items():
            if isinstance(getattr(law, "_cache", None), LawCache):
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


ONE_WARNING = "cache: compiled laws: "


def run_as_stranger(folder, **environment):
    """Return the law's answer and its messages to a user without a home and without rights to write here."""
    command = [*as_user(), sys.executable, str(folder / "law.py")]
    environment = homeless(PYTHONPATH=os.pathsep.join(sys.path)) | environment
    answer = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True, cwd="/"
    )
    return (
        float(answer.stdout.split()[0]),
        int(answer.stdout.split()[1]),
        answer.stderr.splitlines(),
    )


@pytest.mark.parametrize(
    "environment",
    [
        {},
        {"HOME": "/nowhere/at/all"},
        {"HOME": "/proc", "NUMBA_CACHE_DIR": "/proc/laws"},
    ],
    ids=str,
)
def test_without_a_place_for_it_a_law_is_compiled_with_one_warning(folder, environment):
    result, missed, told = run_as_stranger(folder, **environment)
    assert (result, missed, len(told)) == (7.0, 2, 1)
    assert told[0].startswith(f"{ONE_WARNING}no folder can keep them (")
    assert "Set NUMBA_CACHE_DIR to a folder that can be written" in told[0]


def test_a_cache_compiled_by_root_is_used_by_a_user_without_write_access(folder):
    assert run(folder)[:2] == (7.0, 2)
    assert run_as_stranger(folder) == (7.0, 0, [])


def test_a_named_folder_that_cannot_be_written_is_told_and_another_is_used(folder):
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(sys.path),
        "NUMBA_CACHE_DIR": "/proc/laws",
    }
    said = [
        subprocess.run(
            [sys.executable, folder / "law.py"],
            env=environment,
            capture_output=True,
            text=True,
        ).stderr
        for _ in range(2)
    ]
    assert said[0].splitlines() == [
        f"{ONE_WARNING}NUMBA_CACHE_DIR = /proc/laws: No such file or directory: laws are kept in "
        f"{folder / '__pycache__'} instead."
    ]
    assert said[1] == "", "they are found there"


def test_on_a_full_disk_a_law_is_compiled_with_one_warning(folder):
    """The folder of its source, and the home, are on a disk that takes new files and nothing in them."""
    full = folder / "full"
    full.mkdir()
    fill = (
        'mount -t tmpfs -o size=256k none "$0" && cp "$0"/../*.py "$0" && mkdir "$0/__pycache__" && '
        '{ cat /dev/zero >"$0/filler" 2>/dev/null; exec "$1" -B "$0/law.py"; }'
    )
    command = [
        *in_own_namespace("--mount"),
        "sh",
        "-c",
        fill,
        str(full),
        sys.executable,
    ]
    environment = homeless(PYTHONPATH=os.pathsep.join(sys.path), HOME=str(full))
    answer = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    )
    told = answer.stderr.splitlines()
    assert (answer.stdout.split()[:2], len(told)) == (["7.0", "2"], 1)
    assert f"{full / '__pycache__'}: No space left on device" in told[0]


DAMAGES = {
    "emptied": lambda content: b"",
    "cut": lambda content: content[: len(content) // 2],
    "cut at its begin": lambda content: content[:7],
    "zeros": lambda content: bytes(len(content)),
    "garbage": lambda content: bytes(range(256)) * 8,
    "one bit": lambda content: content[:-9] + bytes([content[-9] ^ 1]) + content[-8:],
    "of numba itself": lambda content: pickle.dumps("0.1") + content,
}


def test_damaged_files_are_compiled_anew_with_one_warning(folder):
    run(folder)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    for path in folder.glob("__pycache__/*.nb[ic]"):
        path.write_bytes(DAMAGES["cut"](path.read_bytes()))
    said = [
        subprocess.run(
            [sys.executable, folder / "law.py"],
            env=environment,
            capture_output=True,
            text=True,
        )
        for _ in range(2)
    ]
    assert [answer.stdout.split()[:2] for answer in said] == [
        ["7.0", "2"],
        ["7.0", "0"],
    ]
    assert [len(answer.stderr.splitlines()) for answer in said] == [1, 0]
    assert said[0].stderr.startswith(
        f"{ONE_WARNING}files in {folder / '__pycache__'} are damaged"
    )


KEY, DATA = ("types", ("x86", 1)), {"code": b"machine code" * 40}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_each_kind_of_damage_is_found_and_mended_by_the_next_writing(
    tmp_path, suffix, damage
):
    store = _LawFiles(tmp_path, "law", "d" * 32)
    store.save(KEY, DATA)
    (file,) = tmp_path.glob(f"*.{suffix}")
    file.write_bytes(damage(file.read_bytes()))
    reader = _LawFiles(tmp_path, "law", "d" * 32)
    assert reader.load(KEY) is None
    assert reader.damaged
    reader.save(KEY, DATA)
    assert _LawFiles(tmp_path, "law", "d" * 32).load(KEY) == DATA


@given(
    st.integers(0, 10_000),
    st.binary(max_size=40),
    st.integers(0, 40),
    st.sampled_from(["nbi", "nbc"]),
)
def test_whatever_happens_to_its_files_a_store_returns_what_was_saved_or_nothing(
    at, inserted, removed, suffix
):
    with TemporaryDirectory() as name:
        store = _LawFiles(Path(name), "law", "d" * 32)
        store.save(KEY, DATA)
        (file,) = Path(name).glob(f"*.{suffix}")
        content = file.read_bytes()
        at %= len(content) + 1
        file.write_bytes(content[:at] + inserted + content[at + removed :])
        assert store.load(KEY) in (None, DATA)


def test_files_that_are_gone_unreadable_or_folders_are_as_not_there(tmp_path):
    for suffix, harm in itertools.product(
        ["nbi", "nbc"], [Path.unlink, unreadable, replaced_by_a_folder]
    ):
        store = _LawFiles(tmp_path / f"{suffix}-{harm.__name__}", "law", "d" * 32)
        store.folder.mkdir()
        store.save(KEY, DATA)
        harm(next(store.folder.glob(f"*.{suffix}")))
        assert store.load(KEY) is None
        assert not store.damaged


def unreadable(path):
    """Root may read everything, but not through a link that leads to itself."""
    path.unlink()
    path.symlink_to(path)


def replaced_by_a_folder(path):
    path.unlink()
    path.mkdir()


def test_a_store_never_returns_what_was_saved_under_another_key(tmp_path):
    """Two processes that began with no index both take the first number."""
    one, other = (
        _LawFiles(tmp_path, "law", "d" * 32),
        _LawFiles(tmp_path, "law", "d" * 32),
    )
    one.save("a", 1)
    index = one._index()
    one.forget()
    other.save("b", 2)
    one._write(one._index_name, index)
    assert (one.load("a"), one.load("b")) == (None, None)
    one.save("a", 1)
    other.save("b", 2)
    assert (one.load("a"), other.load("b")) == (1, 2)


def test_a_disk_that_gets_full_half_way_leaves_nothing_and_is_warned_of_once(
    tmp_path, monkeypatch
):
    def full(path, content):
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    store, said = _LawFiles(tmp_path, "law", "d" * 32), []
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        store.save(KEY, DATA)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(cache, "print_line", said.append)
    monkeypatch.setattr(cache, "_fault_of_folder", {tmp_path: ""})
    monkeypatch.delenv("CRAZYCHOIR_TOLD", raising=False)
    for number in range(2):
        kept = LawCache(law_of(f"def law(x): return x + {number}"))
        kept.__dict__["_stores"] = [store]
        kept._save(KEY, DATA)
    assert len(said) == 1
    assert "No space left on device" in said[0]


def test_children_of_a_run_share_a_temporary_folder_only_where_there_is_no_other(
    tmp_path, monkeypatch
):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    with cache.share_with_children(tmp_path):
        assert "NUMBA_CACHE_DIR" not in os.environ
    monkeypatch.setattr(cache, "write_fault", lambda folder: "Read-only file system")
    monkeypatch.setattr(cache, "_fault_of_folder", {})
    with cache.share_with_children(tmp_path):
        assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path / "laws")
    assert "NUMBA_CACHE_DIR" not in os.environ


def test_a_law_in_another_module_has_another_digest():
    def law(x: float) -> float:
        return 2.0 * x

    before = cache.LawCache(law).digest
    law.__module__ = "elsewhere"
    assert cache.LawCache(law).digest != before


def test_a_file_that_all_users_may_write_is_not_read(tmp_path):
    """Reading it runs code."""
    store = _LawFiles(tmp_path, "law", "digest")
    store.save("key", "machine code")
    assert store.load("key") == "machine code"
    for file in tmp_path.iterdir():
        file.chmod(0o666)
    assert store.load("key") is None


def test_an_index_of_another_kind_holds_nothing(tmp_path):
    store = _LawFiles(tmp_path, "law", "digest")
    store._write(store._index_name, 3)
    assert store.load("key") is None


@pytest.mark.parametrize("missing", ["class", "module"])
def test_files_that_name_a_class_of_another_version_hold_nothing(
    tmp_path, monkeypatch, missing
):
    """A signature holds the classes of named tuples: another version may have renamed them."""
    old = types.ModuleType("old_version")
    old.Step = type("Step", (), {"__module__": "old_version"})
    monkeypatch.setitem(sys.modules, "old_version", old)
    store = _LawFiles(tmp_path, "law", "digest")
    store.save("key", old.Step)
    store._write(f"{store._base}.2.nbc", (old.Step, "machine code"))
    if missing == "class":
        del old.Step
    else:
        monkeypatch.delitem(sys.modules, "old_version")
    assert store.load("key") is None, "its data"
    store._write(store._index_name, {"key": f"{store._base}.2.nbc"})
    assert store.load("key") is None, "its key"
    store.save("key", "machine code")
    assert store.load("key") == "machine code"


def test_what_is_written_under_any_umask_is_read(tmp_path):
    before = os.umask(0)
    try:
        store = _LawFiles(tmp_path, "law", "digest")
        store.save("key", "machine code")
        assert store.load("key") == "machine code"
    finally:
        os.umask(before)
