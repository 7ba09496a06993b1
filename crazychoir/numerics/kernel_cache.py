"""What is kept on disk of a compiled law, and when it is compiled anew.

numba's own cache looks at the one file in which a law is written, and would go on with old machine code when a piece or
a constant in another file has changed. This one goes by a digest of all that the machine code is made of: the law's
byte code and, recursively, every piece and every constant that it names. Comments, docstrings and times do not count.
Processes that start together take turns: the first one compiles a law, the others wait and then find it on the disk.
Where nothing can be kept, or what was kept is damaged, laws are compiled, and one line says so.
"""

import builtins
import glob
import inspect
import itertools
import os
import pickle
import sys
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache, cached_property
from hashlib import blake2b
from opcode import opmap
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.caching import InTreeCacheLocator, NullCache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps

from crazychoir.files.user_folders import (
    TOLD_VARIABLE,
    WARNING,
    cache_home,
    first_warning,
    write_fault,
)

locks: Any
try:
    import fcntl as locks
except ImportError:  # elsewhere than on Unix each process compiles for itself
    locks = None

FORMAT = "checked"  # of the files
VERSIONS = (FORMAT, numba.__version__, np.__version__)
NAME = "compiled laws"
"""What this cache holds, in warnings."""
CHECK_SIZE = 16  # bytes at the begin of a file: the digest of the rest
LIBRARIES = ("builtins", "math", "cmath", "numpy", "numba")
"""Packages whose functions and constants are told by their names: the versions say the rest."""
COMPILES = (
    "crazychoir compiles its laws, once on this machine; that takes a minute or two"
)
PATIENCE, LOOK = 2400, 0.05
"""Looks, and s between them, at whether another process has compiled a law; then we do it, too."""
EXACT = (type(None), bool, int, float, complex, str, bytes, type(Ellipsis))
"""Types of values of which `repr` says all; with those of NUMBERS."""
NUMBERS = (np.number, np.bool_, np.dtype, numba.types.Type)

# numba's, without types.
_SETTINGS: Any = numba.config
_REBUILD: Any = CompileResult._rebuild

# Of the byte code: by how many bits the number of a name is shifted, and what may stand between a name's attributes.
GLOBAL, EXTENDED = opmap["LOAD_GLOBAL"], opmap["EXTENDED_ARG"]
ATTRIBUTES = {
    opmap["LOAD_ATTR"]: int(sys.version_info >= (3, 12)),
    opmap.get("LOAD_METHOD", GLOBAL): 0,
}
SILENT = (opmap["CACHE"], EXTENDED)


class Untold(Exception):
    """A law names something of which no digest can be made."""


class Kept(NullCache):
    """The cache of one law; options: how it is compiled.

    It looks at nothing before something is to be compiled, as a piece may name another that is written below it.
    Where no digest can be made nothing is kept, and the law is compiled in each process.
    """

    def __init__(self, law: Callable[..., Any], *options: Any) -> None:
        self._law = law
        self._options = options
        self._busy = False
        self._turn: _Turn | None = None

    @cached_property
    def digest(self) -> str:
        """Of all that the law is compiled of; raises Untold, for one that names itself too."""
        if self._busy:
            raise Untold(self._law.__qualname__)
        self._busy = True
        try:
            # Machine code names the modules of its pieces: it cannot be loaded where a module has moved.
            content = repr(
                (VERSIONS, self._options, self._law.__module__, _function(self._law))
            )
        finally:
            self._busy = False
        return blake2b(content.encode(), digest_size=16).hexdigest()

    @cached_property
    def _stores(self) -> "list[_Store]":
        """The files of this law in each folder, in the order of the folders; none where no digest can be made."""
        try:
            digest = self.digest
        except (Untold, RecursionError):
            return []
        file = inspect.getfile(self._law)
        module = os.path.splitext(os.path.basename(file))[0]
        name = f"{module}.{self._law.__qualname__}".replace("<", "").replace(">", "")
        return [_Store(folder, name, digest) for folder in _folders(file)]

    @property
    def cache_path(self) -> Any:
        """The first folder for its files, None if there is none."""
        return str(self._stores[0].folder) if self._stores else None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The machine code for these types, None if there is none: then it is our turn to compile it."""
        target_context.refresh()
        key = (sig, target_context.codegen().magic_tuple())
        found = self._read(key)
        if found is None:
            self._tell()
            self._turn = _Turn(
                next(
                    (store.place for store in self._stores if not _fault(store.folder)),
                    "",
                )
            )
            found = self._read(key)
            if found is not None:
                self._turn.end()
        return None if found is None else _REBUILD(target_context, *found)

    def _read(self, key: Any) -> Any:
        """Return what the first folder has that has it, None if no folder has it."""
        for store in self._stores:
            found = store.load(key)
            if found is not None:
                return found
        return None

    def _tell(self) -> None:
        """Say in one line why the user waits: the law is compiled."""
        stores = self._stores
        named = _SETTINGS.CACHE_DIR
        free = [store for store in stores if not _fault(store.folder)]
        if stores and not free:
            _warn_of_no_folder(stores)
        elif damaged := [store for store in stores if store.damaged]:
            warn(
                f"files in {damaged[0].folder} are damaged: the laws are compiled anew, which takes a minute or two."
            )
        elif named and free and free[0] is not stores[0]:
            warn(
                f"NUMBA_CACHE_DIR = {named}: {_fault(stores[0].folder)}: laws are kept in {free[0].folder} instead."
            )
        else:
            say_once()

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the machine code for these types in the first folder that takes it."""
        if (
            all(part.can_cache for part in data.lifted)
            and not data.library.has_dynamic_globals
        ):
            self._save((sig, data.codegen.magic_tuple()), data._reduce())
        self.give_up()

    def _save(self, key: Any, data: Any) -> None:
        for store in self._stores:
            if _fault(store.folder):
                continue
            try:
                store.save(key, data)
            except OSError as error:
                _FAULTS[store.folder] = error.strerror or str(error)
            else:
                return
        if self._stores:
            _warn_of_no_folder(self._stores)

    def give_up(self) -> None:
        """Let others compile it, whether we have or not."""
        if self._turn is not None:
            self._turn.end()

    def flush(self) -> None:
        """Forget all of it."""
        for store in self._stores:
            store.forget()


def keep(dispatcher: Any, law: Callable[..., Any], *options: Any) -> None:
    """Give a law its cache.

    What breaks compiling off, as a signal does, ends our turn: we would wait for ourselves, and the others, too.
    """
    kept = Kept(law, *options)
    compile_law = dispatcher.compile

    def compile_in_turn(types: Any) -> Any:
        try:
            return compile_law(types)
        except BaseException:
            kept.give_up()
            raise

    dispatcher._cache = kept
    dispatcher.compile = compile_in_turn


def say(text: str) -> None:
    """A line for who waits; a program whose standard error nobody reads puts another function in this one's place."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


@cache
def say_once() -> None:
    """People who wait, for this process or one that it has started, are told what for, if they have not been warned."""
    if NAME not in os.environ.get(TOLD_VARIABLE, "").split(","):
        say(COMPILES)


def warn(text: str) -> None:
    """Say once, of this process and those that it starts, what is wrong with the cache."""
    tell(f"{WARNING}{NAME}: {text}")


def tell(warning: str) -> None:
    """Say a warning of this process, or of one that it has started, if it is the first."""
    if first_warning(NAME):
        say(warning)


def is_kept() -> bool:
    """Return whether compiled laws of this package can be written to some folder."""
    return any(not _fault(folder) for folder in _folders(__file__))


@contextmanager
def shared_by_children(folder: Path) -> Iterator[None]:
    """Let processes that are started meanwhile share what they compile, in a temporary folder if no other takes it.

    Else each of them would compile all laws by itself.
    """
    if is_kept():
        yield
        return
    before = os.environ.get("NUMBA_CACHE_DIR")
    os.environ["NUMBA_CACHE_DIR"] = str(folder / "laws")
    try:
        yield
    finally:
        del os.environ["NUMBA_CACHE_DIR"]
        if before is not None:
            os.environ["NUMBA_CACHE_DIR"] = before


def _folders(file: str) -> list[Path]:
    """Return where laws of a source file may be kept: NUMBA_CACHE_DIR, beside the file, the user's cache.

    They are read from each, and written to the first that can be written. A package that root has installed and
    compiled once is read by all users.
    """
    found = []
    below = InTreeCacheLocator.get_suitable_cache_subpath(file)  # type: ignore[no-untyped-call]
    if _SETTINGS.CACHE_DIR:
        found.append(Path(_SETTINGS.CACHE_DIR, below))
    if os.path.exists(file):  # a cell of a notebook has none
        found.append(Path(file).parent / "__pycache__")
    own = cache_home()
    if own is not None:
        found.append(own / "numba" / below)
    return found


_FAULTS: dict[Path, str] = {}
"""Why nothing can be written to a folder, empty if it can, of the folders that this process has tried."""


def _fault(folder: Path) -> str:
    if folder not in _FAULTS:
        _FAULTS[folder] = write_fault(folder)
    return _FAULTS[folder]


def _warn_of_no_folder(stores: "list[_Store]") -> None:
    tried = "; ".join(f"{store.folder}: {_fault(store.folder)}" for store in stores)
    if cache_home() is None:
        tried += "; there is no home folder"
    warn(
        f"no folder can keep them ({tried}): they are compiled anew each time, which takes a minute or two. "
        "Set NUMBA_CACHE_DIR to a folder that can be written and has room."
    )


class _Turn:
    """The only process that compiles a law, until `end`, or its own end; place: of a file that says so, "" for none."""

    def __init__(self, place: str) -> None:
        self._place = place
        self._file = -1
        if locks is None or not place:
            return
        with suppress(OSError):  # where nothing can be written nothing is kept
            os.makedirs(os.path.dirname(place), exist_ok=True)
            self._file = os.open(place, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
            self._wait()

    def _wait(self) -> None:
        pause = threading.Event()
        for _ in range(PATIENCE):
            try:
                locks.flock(self._file, locks.LOCK_EX | locks.LOCK_NB)
            except BlockingIOError:
                pause.wait(LOOK)
            else:
                return

    def end(self) -> None:
        """Who waits looks whether the machine code is there now."""
        if self._file >= 0:
            _remove(self._place)
            os.close(self._file)
            self._file = -1


class _Store:
    """The files of a law with one digest in one folder: machine code of each signature, and an index of them.

    Each file begins with the digest of the rest: what was cut off, emptied or spoilt is found before it is read, and
    counts as not there. damaged: whether such a file was found.
    """

    def __init__(self, folder: Path, name: str, digest: str) -> None:
        self.folder = folder
        self.damaged = False
        self._name = name
        self._digest = digest
        self._base = f"{name}-{digest}.{sys.implementation.cache_tag}{getattr(sys, 'abiflags', '')}"

    @property
    def place(self) -> str:
        """Of the file that says who compiles it."""
        return str(self.folder / f"{self._base}.turn")

    @property
    def _index_name(self) -> str:
        return f"{self._base}.nbi"

    def load(self, key: Any) -> Any:
        """Return what was saved with this key, None if nothing was, or if it cannot be read."""
        name = self._index().get(key)
        content = None if name is None else self._read(name)
        if content is None:
            return None
        saved_key, data = pickle.loads(content)  # noqa: S301 - from folders of this user, of root, or of the package
        return (
            data if saved_key == key else None
        )  # else another process has taken the same number for its file

    def save(self, key: Any, data: Any) -> None:
        """Write it, and remove the files of other digests of the law; raises OSError if it cannot be written."""
        index = self._index()
        numbers = itertools.count(1)
        taken = list(index.values())
        name = index.get(key) or next(
            n for k in numbers if (n := f"{self._base}.{k}.nbc") not in taken
        )
        self._write(name, (key, data))
        self._write(self._index_name, index | {key: name})
        others = glob.escape(self._base).replace(self._digest, "?" * len(self._digest))
        for path in glob.glob(
            os.path.join(glob.escape(str(self.folder)), f"{others}.*nb[ic]")
        ):
            if self._digest not in path:
                _remove(path)

    def forget(self) -> None:
        """Remove the index."""
        _remove(str(self.folder / self._index_name))

    def _index(self) -> dict[Any, str]:
        content = self._read(self._index_name)
        index = {} if content is None else pickle.loads(content)  # noqa: S301 - as above
        return index if isinstance(index, dict) else {}

    def _read(self, name: str) -> bytes | None:
        """Return the content of a file, None if it is not there, not ours to read, or damaged."""
        try:
            with open(self.folder / name, "rb") as file:
                if not self._is_trusted(os.fstat(file.fileno())):
                    return None
                content = file.read()
        except OSError:
            return None
        check = content[:CHECK_SIZE]
        rest = content[CHECK_SIZE:]
        if check != blake2b(rest, digest_size=CHECK_SIZE).digest():
            self.damaged = True
            return None
        return rest

    def _is_trusted(self, file: os.stat_result) -> bool:
        """Return whether a file was written by this user, by root or by the owner of the package.

        Reading it runs code: a file of another user, or one that all users may write, is not read.
        """
        if sys.platform == "win32":
            return True
        package_owner = os.stat(__file__).st_uid
        return (
            file.st_uid in (0, os.getuid(), package_owner) and not file.st_mode & 0o002
        )

    def _write(self, name: str, value: Any) -> None:
        """Write a file whole or not at all."""
        content = dumps(value)  # type: ignore[no-untyped-call]
        partial = self.folder / f"{name}.tmp.{uuid.uuid4().hex[:16]}"
        try:
            partial.write_bytes(
                blake2b(content, digest_size=CHECK_SIZE).digest() + content
            )
            partial.replace(self.folder / name)
        except BaseException:
            _remove(str(partial))
            raise


def _remove(path: str) -> None:
    try:
        os.remove(path)
    except OSError:  # another process was first, or it is another user's
        return


def _function(law: Callable[..., Any]) -> Any:
    """All that a function is made of, as nested tuples."""
    if not isinstance(law, FunctionType):
        raise Untold(repr(law))
    try:
        cells = [cell.cell_contents for cell in law.__closure__ or ()]
    except ValueError as empty:
        raise Untold(law.__qualname__) from empty
    given = (
        law.__defaults__,
        tuple(sorted((law.__kwdefaults__ or {}).items())),
        tuple(cells),
    )
    return _code(law.__code__, law.__globals__, law.__doc__), _value(given)


def _code(code: CodeType, names: Mapping[str, Any], doc: str | None = None) -> Any:
    """Byte code with its constants and what its global names mean."""
    constants = [
        None if k == 0 and c == doc else c for k, c in enumerate(code.co_consts)
    ]
    return (
        (code.co_code, code.co_exceptiontable, code.co_flags, code.co_names),
        (
            code.co_argcount,
            code.co_posonlyargcount,
            code.co_kwonlyargcount,
            code.co_varnames,
        ),
        (code.co_freevars, code.co_cellvars),
        [_code(c, names) if isinstance(c, CodeType) else _value(c) for c in constants],
        [_meaning(path, names) for path in _paths(code)],
    )


def _paths(code: CodeType) -> list[list[str]]:
    """The global names of a byte code, with the attributes that it takes of them: ["math", "sqrt"].

    As `dis` would say, in a twentieth of its time.
    """
    paths: list[list[str]] = []
    inside = False
    high = 0
    for operation, low in zip(code.co_code[::2], code.co_code[1::2], strict=True):
        number = high | low
        high = number << 8 if operation == EXTENDED else 0
        if operation == GLOBAL:
            paths.append([code.co_names[number >> 1]])
            inside = True
        elif inside and operation in ATTRIBUTES:
            paths[-1].append(code.co_names[number >> ATTRIBUTES[operation]])
        elif operation not in SILENT:
            inside = False
    return paths


def _meaning(path: list[str], names: Mapping[str, Any]) -> Any:
    """What a path leads to: through modules only, as a value says all of its attributes."""
    first, *rest = path
    if first not in names and not hasattr(builtins, first):
        raise Untold(first)
    value = names[first] if first in names else getattr(builtins, first)
    for name in rest:
        if not isinstance(value, ModuleType):
            break
        if _of_library(value.__name__):
            return value.__name__, rest
        value = getattr(value, name)
    return _value(value)


def _value(value: Any) -> Any:
    """A constant, a compiled piece, or a library's function, as something that `repr` tells from any other."""
    kind = type(value)
    if kind in EXACT or isinstance(value, NUMBERS):
        return f"{kind.__module__}.{kind.__qualname__}", repr(value)
    if isinstance(value, Dispatcher):
        return _piece(value)
    if isinstance(value, tuple):
        return (
            f"{kind.__module__}.{kind.__qualname__}",
            getattr(value, "_fields", ()),
            [_value(v) for v in value],
        )
    if isinstance(value, frozenset):
        return "frozenset", sorted(repr(_value(v)) for v in value)
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return (
            "array",
            repr(value.dtype),
            value.shape,
            value.strides,
            value.flags.writeable,
            value.tobytes(),
        )
    if isinstance(value, type | FunctionType | BuiltinFunctionType) and _of_library(
        value.__module__
    ):
        return value.__module__, value.__qualname__
    raise Untold(repr(value))


def _piece(piece: Any) -> Any:
    """A compiled piece: one of ours has its digest; of another, whose types may be fixed, all that it is made of."""
    if isinstance(piece._cache, Kept):
        return "piece", piece._cache.digest
    types = [] if piece._can_compile else [repr(types) for types in piece.signatures]
    return "piece", sorted(piece.targetoptions.items()), types, _function(piece.py_func)


def _of_library(module: str | None) -> bool:
    return module is not None and module.partition(".")[0] in LIBRARIES
