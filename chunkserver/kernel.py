"""The one way to compile: every jitted function of the project is made by `kernel`, `inlined` or `spliced`.

Policy, argued once:

- `fastmath=False`. Two chunks recompute the same sample and must agree to the bit, on any machine. Reordering or
  contraction changes bits from one CPU to the next, and folds away the rounding that noise splits coordinates with:
  another world. It would make extraction 4 % faster (median of seven pairs on the same samples, AVX2).
- `error_model="numpy"`. A division by zero gives inf instead of a Python exception: kernels never raise, and loops
  with a division vectorise.
- `nogil=True`. Kernels touch arrays and scalars only.
- `inlined` for scalar functions that are called once per sample: Numba leaves a large callee out of line, and a loop
  with a call in it does not vectorise (simplex noise is then 6.5 times slower, measured with AVX2). They live in the
  code of their callers only, so they are neither cached nor callable from Python: that saves a tenth of the compile.
- `spliced` for functions that only choose which kernel to call. They are copied into their caller before it is
  compiled. A caller's code is optimised together with that of all kernels below it, so each level of calls would do
  that again: the interpreter compiles in 13 s instead of 20.
- `cache=True`, in a folder named after a digest of the sources. Numba checks only the file of the cached function
  itself: when a callee in another file changes, the caller's old machine code comes back, and with it old terrain. A
  new digest is a new folder, so nothing stale can be found. Recipes are left out of it: they are what kernels run, not
  what they are made of (`tests/house/test_kernels.py`), so a new built-in compiles nothing.

Five things are written out for the compiler, which does not find them by itself: `lanes_below`, many comparisons at
once, `prefetch`, `choose`, `uncounted`, and `aligned_stack`. They are plain code of its intermediate language, so any
processor has them, and are Python functions where nothing is compiled.

`SOURCES_DIGEST` covers every source that the bytes of a chunk depend on, and is part of the generator version. The CPU
is not part of it: the bits are the same on all of them.
"""

import hashlib
import logging
import os
import tempfile
import zipfile
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba
import numba.extending
import numpy as np
import platformdirs
from llvmlite import ir  # type: ignore[import-untyped]
from numpy.typing import NDArray

_log: Final = logging.getLogger(__name__)

PACKAGE: Final = Path(__file__).parent
NOT_IN_DIGEST: Final = (
    *("__init__.py", "__main__.py", "commands", "errors.py", "memory.py", "worker.py", "world.py", "store", "server"),
    *("stream", "wire/reading"),
)
"""What no byte of a chunk depends on: entry points, errors, where worlds are kept, who is told of edits, the service
around `build_chunk`; and the reader of files that are there already."""

NOT_COMPILED: Final = (*NOT_IN_DIGEST, "recipe")
"""What no kernel is made of, beyond that."""

DIGEST_BYTES: Final = 16


def sources_digest(package: Path, left_out: Collection[str] = NOT_IN_DIGEST) -> str:
    """Return the hex digest of all sources below `package`, names included, but for the files and folders left out."""
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package)
        if not any(name.is_relative_to(path) for path in left_out):
            source = path.read_bytes()
            digest.update(f"{name.as_posix()} {len(source)}\n".encode() + source)
    return digest.hexdigest()


def cache_root() -> Path:
    """Return the folder of all compiled code: `CHUNKSERVER_CACHE_DIR`, or the user's cache folder."""
    chosen = os.environ.get("CHUNKSERVER_CACHE_DIR")
    return Path(chosen) if chosen else platformdirs.user_cache_path("chunkserver")


SOURCES_DIGEST: Final = sources_digest(PACKAGE)
CACHE_DIR: Final = cache_root() / f"kernels-{sources_digest(PACKAGE, NOT_COMPILED)}"
setattr(numba.config, "CACHE_DIR", str(CACHE_DIR))  # noqa: B010 - numba's types know no settings

_POLICY: Final[dict[str, Any]] = {"fastmath": False, "error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
_KERNEL: Final[dict[str, Any]] = {**_POLICY, "cache": True}
_SPLICED: Final[dict[str, Any]] = {**_POLICY, "inline": "always"}
_INLINED: Final[dict[str, Any]] = {**_POLICY, "forceinline": True, "no_cpython_wrapper": True}

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Number = TypeVar("_Number")
_Array = TypeVar("_Array", bound=NDArray[Any])


def kernel(function: _Function) -> _Function:
    """Compile `function` at its first call, or load it from `CACHE_DIR`."""
    jitted: _Function = numba.njit(**_KERNEL)(function)
    return jitted


def inlined(function: _Function) -> _Function:
    """Compile `function` into each of the kernels that call it: for scalar code inside loops that must vectorise."""
    jitted: _Function = numba.njit(**_INLINED)(function)
    return jitted


def spliced(function: _Function) -> _Function:
    """Copy `function` into each of the kernels that call it, as if it stood there: for what only calls kernels."""
    jitted: _Function = numba.njit(**_SPLICED)(function)
    return jitted


CACHE_LINE: Final = 64
"""Bytes."""
LANES: Final = 16
"""How many values `lanes_below` compares."""


def _lanes_below(values: NDArray[np.float32], at: np.uint64, limit: np.float32) -> np.uint64:
    """Return which of the `LANES` values from index `at` on are below `limit`: bit k for `values[at + k]`.

    values: (n,) float32, C order. All of `values[at]` to `values[at + LANES - 1]` must exist: it is not checked.
    """
    flags = 0
    for lane in range(LANES):
        flags |= int(values[int(at) + lane] < limit) << lane
    return np.uint64(flags)


def _vector_below(_typing: Any, values: Any, at: Any, limit: Any) -> Any:
    """Return the signature of `lanes_below` and what writes it in the compiler's intermediate language."""
    vector = ir.VectorType(ir.FloatType(), LANES)

    def write(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[Any]) -> Any:
        start = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        first = builder.bitcast(builder.gep(start, [arguments[1]]), vector.as_pointer())
        loaded = builder.load(first, align=4)
        one = builder.insert_element(ir.Constant(vector, ir.Undefined), arguments[2], ir.IntType(32)(0))
        all_alike = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        flags = builder.fcmp_ordered("<", loaded, builder.shuffle_vector(one, one, all_alike))
        return builder.zext(builder.bitcast(flags, ir.IntType(LANES)), ir.IntType(64))

    return numba.uint64(values, at, limit), write


def _prefetch(values: NDArray[np.float32], at: np.uint64) -> None:
    """Have `values[at]` brought nearer, for it will be read soon. A hint: `at` may lie outside, nothing is read."""


def _machine_prefetch(_typing: Any, values: Any, at: Any) -> Any:
    """Return the signature of `prefetch` and what writes it in the compiler's intermediate language."""
    number, pointer = ir.IntType(32), ir.IntType(8).as_pointer()
    hint = ir.FunctionType(ir.VoidType(), [pointer, number, number, number])

    def write(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[Any]) -> Any:
        start = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        address = builder.bitcast(builder.gep(start, [arguments[1]]), pointer)
        to_read, every_level, into_data = number(0), number(3), number(1)
        builder.call(
            builder.module.declare_intrinsic("llvm.prefetch", [pointer], hint),
            [address, to_read, every_level, into_data],
        )
        return context.get_dummy_value()

    return numba.void(values, at), write


_Below = Callable[[NDArray[np.float32], np.uint64, np.float32], np.uint64]
_IS_COMPILED: Final = not getattr(numba.config, "DISABLE_JIT")  # noqa: B009 - numba's types know no settings

lanes_below: Final[_Below] = cast(_Below, numba.extending.intrinsic(_vector_below)) if _IS_COMPILED else _lanes_below
prefetch: Final[Callable[[NDArray[np.float32], np.uint64], None]] = (
    cast(Any, numba.extending.intrinsic(_machine_prefetch)) if _IS_COMPILED else _prefetch
)


def _uncounted(array: _Array) -> _Array:
    """Return the same array, whose users are not counted: for a kernel's arguments, which its caller holds anyway.

    Numba counts every view and every array handed on, by instructions that lock memory: 30 ns a call of a kernel.
    """
    return array


def _without_count(_typing: Any, array: Any) -> Any:
    """Return the signature of `uncounted` and what writes it in the compiler's intermediate language."""

    def write(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[Any]) -> Any:
        view = context.make_array(signature.args[0])(context, builder, arguments[0])
        view.meminfo = ir.Constant(view.meminfo.type, None)
        view.parent = ir.Constant(view.parent.type, None)
        return view._getvalue()

    return array(array), write


def _aligned_stack() -> None:
    """Have the calling kernel begin its part of the stack at a whole line of the cache.

    For a loop with more numbers than the CPU has registers. LLVM keeps the others on the stack, where vectors that lie
    across two lines take twice the time, and where a process' stack begins is chance.
    """


def _with_aligned_stack(_typing: Any) -> Any:
    """Return the signature of `aligned_stack` and what writes it in the compiler's intermediate language."""

    def write(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Sequence[Any]) -> Any:  # noqa: ARG001
        with builder.goto_entry_block():
            place = builder.alloca(ir.IntType(8))
        place.align = CACHE_LINE
        used = ir.FunctionType(ir.VoidType(), [place.type])
        builder.asm(used, "", "r", [place], side_effect=True)
        return context.get_dummy_value()

    return numba.void(), write


def choose(flag: Any, yes: _Number, no: _Number) -> _Number:
    """Return `yes if flag else no`, for two numbers of one type that are there anyway.

    In a kernel it is one instruction. Numba makes a branch of a conditional, and LLVM is free to read memory on one
    side of a branch alone: then a loop has masked loads in it, or no vectors at all.
    """
    return yes if flag else no


def _choose_in_kernels(_context: Any, flag: Any, yes: Any, no: Any) -> Any:  # noqa: ARG001 - it has the type of yes
    """Type `choose` as (bool, T, T) -> T, and make one instruction of it."""
    return yes(flag, yes, yes), lambda _, builder, __, arguments: builder.select(*arguments)


uncounted: Final[Callable[[_Array], _Array]] = (
    cast(Any, numba.extending.intrinsic(_without_count)) if _IS_COMPILED else _uncounted
)

aligned_stack: Final[Callable[[], None]] = (
    cast(Any, numba.extending.intrinsic(_with_aligned_stack)) if _IS_COMPILED else _aligned_stack
)

if _IS_COMPILED:
    choose = numba.extending.intrinsic(_choose_in_kernels)  # type: ignore[assignment]


def kept(name: str, make: Callable[[], Sequence[NDArray[Any]]]) -> list[NDArray[Any]]:
    """Return the arrays that `make` makes: made once, then read from `CACHE_DIR`.

    A file that cannot be read is made again, and one that cannot be written is not kept: neither is an error.
    """
    path = CACHE_DIR / f"{name}.npz"
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return [stored[f"arr_{number}"] for number in range(len(stored.files))]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        arrays = list(make())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            np.savez(written := Path(folder) / path.name, *arrays)
            written.replace(path)
    except OSError as error:
        _log.warning("%s cannot be kept: %s", path, error)
    return arrays
