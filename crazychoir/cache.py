"""What is kept on disk of a compiled law, and when it is compiled anew.

numba's own cache looks at the one file in which a law is written, and would go on with old machine code when a piece or
a constant in another file has changed. This one goes by a digest of all that the machine code is made of: the law's
byte code and, recursively, every piece and every constant that it names. Comments, docstrings and times do not count.
Processes that start together take turns: the first one compiles a law, the others wait and then find it on the disk.
"""

import builtins
import glob
import os
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, cached_property
from hashlib import blake2b
from opcode import opmap
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, NullCache
from numba.core.dispatcher import Dispatcher

locks: Any
try:
    import fcntl as locks
except ImportError:  # elsewhere than on Unix each process compiles for itself
    locks = None

VERSIONS = (numba.__version__, np.__version__)
LIBRARIES = ("builtins", "math", "cmath", "numpy", "numba")
"""Packages whose functions and constants are told by their names: the versions say the rest."""
COMPILES = "crazychoir compiles its laws, once on this machine; that takes a minute or two"
PATIENCE, LOOK = 2400, 0.05
"""Looks, and s between them, at whether another process has compiled a law; then we do it, too."""
EXACT = (type(None), bool, int, float, complex, str, bytes, type(Ellipsis))
"""Types of values of which `repr` says all; with those of NUMBERS."""
NUMBERS = (np.number, np.bool_, np.dtype, numba.types.Type)

# Of the byte code: by how many bits the number of a name is shifted, and what may stand between a name's attributes.
GLOBAL, EXTENDED = opmap["LOAD_GLOBAL"], opmap["EXTENDED_ARG"]
ATTRIBUTES = {opmap["LOAD_ATTR"]: int(sys.version_info >= (3, 12)), opmap.get("LOAD_METHOD", GLOBAL): 0}
SILENT = (opmap["CACHE"], EXTENDED)


class Untold(Exception):
    """A law names something of which no digest can be made."""


class Kept(NullCache):
    """The cache of one law; options: how it is compiled.

    It looks at nothing before something is to be compiled, as a piece may name another that is written below it.
    Where no digest can be made nothing is kept, and the law is compiled in each process.
    """

    def __init__(self, law: Callable[..., Any], *options: Any) -> None:
        self._law, self._options, self._busy = law, options, False
        self._turn: _Turn | None = None

    @cached_property
    def digest(self) -> str:
        """Of all that the law is compiled of; raises Untold, for one that names itself too."""
        if self._busy:
            raise Untold(self._law.__qualname__)
        self._busy = True
        try:
            content = repr((VERSIONS, self._options, _function(self._law)))
        finally:
            self._busy = False
        return blake2b(content.encode(), digest_size=16).hexdigest()

    @cached_property
    def _files(self) -> Any:
        try:
            return _Files(self._law, self.digest)
        except (Untold, RecursionError):
            return NullCache()

    @property
    def cache_path(self) -> Any:
        """The folder of its files."""
        return self._files.cache_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The machine code for these types, None if there is none: then it is our turn to compile it."""
        found = self._files.load_overload(sig, target_context)
        if found is None:
            say_once()
            self._turn = _Turn(getattr(self._files, "place", ""))
            found = self._files.load_overload(sig, target_context)
            if found is not None:
                self._turn.end()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the machine code for these types."""
        self._files.save_overload(sig, data)
        self.give_up()

    def give_up(self) -> None:
        """Let others compile it, whether we have or not."""
        if self._turn is not None:
            self._turn.end()

    def flush(self) -> None:
        """Forget all of it."""
        self._files.flush()


def keep(dispatcher: Any, law: Callable[..., Any], *options: Any) -> None:
    """Give a law its cache.

    What breaks compiling off, as a signal does, ends our turn: we would wait for ourselves, and the others, too.
    """
    kept, compile_law = Kept(law, *options), dispatcher.compile

    def compile_in_turn(types: Any) -> Any:
        try:
            return compile_law(types)
        except BaseException:
            kept.give_up()
            raise

    dispatcher._cache, dispatcher.compile = kept, compile_in_turn


def say(text: str) -> None:
    """A line for who waits; a program whose standard error nobody reads puts another function in this one's place."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


@cache
def say_once() -> None:
    """People who wait, for this process or one that it has started, are told what for."""
    say(COMPILES)


class _Turn:
    """The only process that compiles a law, until `end`, or its own end; place: of a file that says so, "" for none."""

    def __init__(self, place: str) -> None:
        self._place, self._file = place, -1
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


class _Place(CompileResultCacheImpl):
    """The folder that numba would choose, a name with the digest: no process reads what one of other content writes."""

    def __init__(self, law: Callable[..., Any], digest: str) -> None:
        self._digest = digest
        super().__init__(law)  # type: ignore[no-untyped-call]

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """How the files of this law begin."""
        name = fullname.replace("<", "").replace(">", "")
        return f"{name}-{self._digest}.{sys.implementation.cache_tag}{abiflags}"


class _Files(FunctionCache):
    """The files of a law with one digest; when they are written, those of its other digests go."""

    def __init__(self, law: Callable[..., Any], digest: str) -> None:
        self._name, self._py_func, self._digest = repr(law), law, digest
        self._impl = _Place(law, digest)
        self._cache_path = self._impl.locator.get_cache_path()
        files: Any = IndexDataCacheFile
        self._cache_file = files(self._cache_path, self._impl.filename_base, digest)
        self.enable()  # type: ignore[no-untyped-call]

    @property
    def place(self) -> str:
        """Of the file that says who compiles it."""
        return os.path.join(self._cache_path, f"{self._impl.filename_base}.turn")

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the machine code for these types."""
        super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        others = glob.escape(self._impl.filename_base).replace(self._digest, "?" * len(self._digest))
        for path in glob.glob(os.path.join(glob.escape(self._cache_path), f"{others}.*nb[ic]")):
            if self._digest not in path:
                _remove(path)


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
    given = (law.__defaults__, tuple(sorted((law.__kwdefaults__ or {}).items())), tuple(cells))
    return _code(law.__code__, law.__globals__, law.__doc__), _value(given)


def _code(code: CodeType, names: Mapping[str, Any], doc: str | None = None) -> Any:
    """Byte code with its constants and what its global names mean."""
    constants = [None if k == 0 and c == doc else c for k, c in enumerate(code.co_consts)]
    return (
        (code.co_code, code.co_exceptiontable, code.co_flags, code.co_names),
        (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_varnames),
        (code.co_freevars, code.co_cellvars),
        [_code(c, names) if isinstance(c, CodeType) else _value(c) for c in constants],
        [_meaning(path, names) for path in _paths(code)],
    )


def _paths(code: CodeType) -> list[list[str]]:
    """The global names of a byte code, with the attributes that it takes of them: ["math", "sqrt"].

    As `dis` would say, in a twentieth of its time.
    """
    paths: list[list[str]] = []
    inside, high = False, 0
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
        return f"{kind.__module__}.{kind.__qualname__}", getattr(value, "_fields", ()), [_value(v) for v in value]
    if isinstance(value, frozenset):
        return "frozenset", sorted(repr(_value(v)) for v in value)
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return "array", repr(value.dtype), value.shape, value.strides, value.flags.writeable, value.tobytes()
    if isinstance(value, type | FunctionType | BuiltinFunctionType) and _of_library(value.__module__):
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
