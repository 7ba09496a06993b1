"""How a law is compiled: the decorator `kernel` and the types of its arguments."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

from crazychoir.numerics.compiling import LATER
from crazychoir.numerics.kernel_cache import keep

Law = TypeVar("Law", bound=Callable[..., Any])

# What a kernel reads (frozen arrays fit, writable ones too) and what it writes.
real = numba.float64
vector = numba.types.Array(numba.float64, 1, "C", readonly=True)
matrix = numba.types.Array(numba.float64, 2, "C", readonly=True)
memory = numba.float64[::1]
table = numba.float64[:, ::1]


def kernel(*arguments: Any, **options: bool) -> Callable[[Law], Law]:
    """Compile a law for these argument types when its module is imported; after the first time, from the disk.

    A program that has something to check first lets them wait, see crazychoir.numerics.compiling.

    Fixed types on purpose: another kind of array raises TypeError at once instead of compiling for a second in flight.
    Without arguments: a piece of other kernels, compiled with them. options: of numba, as nogil and forceinline.
    """

    def compiled(law: Law) -> Law:
        # Nobody calls a law by its address: a tenth of the time to compile goes into what would allow it.
        njit: Any = numba.njit
        dispatcher = njit(error_model="numpy", no_cfunc_wrapper=True, **options)(law)
        if dispatcher is law:  # with NUMBA_DISABLE_JIT
            return law
        keep(dispatcher, law, arguments, sorted(dispatcher.targetoptions.items()))
        if arguments:
            LATER.compile_or_wait(dispatcher, arguments)
        return cast(Law, dispatcher)

    return compiled
