"""Compilation of laws: the decorator `kernel` and the types of its arguments."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.numerics.compiling import KERNEL_QUEUE
from crazychoir.numerics.kernel_cache import attach_cache

Law = TypeVar("Law", bound=Callable[..., Any])
"""A function of Python that is compiled."""

Record = Any
"""A record of an array of records: kernels read and write its fields as attributes."""
Records = npt.NDArray[np.void]
"""An array (n,) of records."""

# Arguments that a kernel reads: frozen arrays and writable arrays fit.
real = numba.float64
"""A number that a kernel reads."""
boolean = numba.boolean
"""A truth value that a kernel reads."""
whole = numba.int64
"""A whole number that a kernel reads."""
vector = numba.types.Array(numba.float64, 1, "C", readonly=True)
"""An array (n,) that a kernel reads."""
matrix = numba.types.Array(numba.float64, 2, "C", readonly=True)
"""An array (m, n) that a kernel reads."""
flags = numba.types.Array(numba.boolean, 1, "C", readonly=True)
"""An array (n,) of truth values that a kernel reads."""
memory = numba.float64[::1]
"""An array (n,) that a kernel writes."""
bools = numba.types.Array(numba.boolean, 1, "C", readonly=True)
"""An array (n,) of truth values that a kernel reads."""
wholes = numba.int64[::1]
"""An array (n,) of whole numbers that a kernel writes."""
table = numba.float64[:, ::1]
"""An array (m, n) that a kernel writes."""

NO_COUNTING = {"_nrt": False}
"""Options of a kernel that makes no arrays: it counts no references to the arrays that it gets.

Counting them costs more than a short law, in each law that it calls as well.
"""


def rows_of(layout: np.dtype[Any]) -> Any:
    """Return the type of an array (n,) of records that a kernel reads and writes.

    Kernels with argument types take an array inside a record as a slice: `row.state[:]`.

    layout: names and types of the fields: float64, int64, uint64, or arrays of these
    """
    return numba.types.Array(numba.from_dtype(layout), 1, "C")


def kernel(*arguments: Any, **options: bool) -> Callable[[Law], Law]:
    """Compile a law for these argument types when its module is imported.

    Later runs load it from disk. A program that must check something first lets the laws wait: see
    crazychoir.numerics.compiling.

    The types are fixed on purpose: another kind of array raises TypeError at once, instead of
    compiling for a second in flight. Without argument types, the law is a part of other kernels and
    is compiled with them.

    arguments: types of the law's arguments
    options: options of numba, such as nogil and forceinline
    """

    def compiled(law: Law) -> Law:
        # No code calls a law by its C address: leaving out the C wrapper saves a tenth of the
        # compilation.
        njit: Any = numba.njit
        dispatcher = njit(error_model="numpy", no_cfunc_wrapper=True, **options)(law)
        if dispatcher is law:  # with NUMBA_DISABLE_JIT
            return law
        attach_cache(
            dispatcher, law, arguments, sorted(dispatcher.targetoptions.items())
        )
        if arguments:
            KERNEL_QUEUE.compile_or_wait(dispatcher, arguments)
        return cast(Law, dispatcher)

    return compiled
