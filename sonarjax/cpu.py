"""Everything that only serves speed on a CPU: optional, used only by entry points.

`tune()` sets the process up (compiler flags, compilation cache) before anything is computed. `CpuEngine` spreads work
over the cores, and stores traced programs next to the compiled ones, so that a second process skips Python's tracing.
In your own script use two lines: `sonarjax.cpu.tune()`, then `Recognizer(..., engine=sonarjax.cpu.CpuEngine())`.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from importlib import metadata
from itertools import islice
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax import export

from sonarjax.engine import Engine
from sonarjax.io.atomic import write_atomic
from sonarjax.io.errors import SonarjaxError
from sonarjax.refine import Drawn, Evidence, PoseEstimate
from sonarjax.render.bank import BankViews
from sonarjax.scene import Pose
from sonarjax.sensor import EchoLaw

MIN_COMPILE_SECONDS = 0.2
"""Programs that compile faster than this [s] are not stored: reading the file back would save nothing."""
# The emitters of XLA's older CPU compiler compile the renderer in half the time, into code that is no slower. Newer
# versions do not know this flag, and end a process that sets it.
FLAGS = ("--xla_cpu_use_fusion_emitters=false",) if jax.__version_info__ < (0, 11) else ()
COMPILER_OPTIONS = {"xla_backend_optimization_level": 1, "xla_llvm_disable_expensive_passes": True}
"""How the programs of `CpuEngine` are compiled: in four fifths of the time, into code that was no slower
where it was measured. JAX's setting JAX_DISABLE_MOST_OPTIMIZATIONS takes precedence.
"""
# <malloc.h>: M_ARENA_MAX, M_MMAP_MAX, M_TRIM_THRESHOLD and M_TOP_PAD.
_MEMORY = {-8: 1, -4: 0, -1: 2**31 - 1, -2: 256 * 2**20}
_CACHE = "jax_compilation_cache_dir"
_OFF = ("", "0", "false", "no")
_SETTINGS = "jax_threefry_partitionable", "jax_default_prng_impl", "jax_default_matmul_precision", "jax_enable_x64"
"""JAX's settings that become part of a program while it is traced."""
_LIBRARIES = "jax", "jaxlib", "flax", "jaxopt"
"""Libraries whose code becomes part of a program."""
DIGEST_BYTES = 32
"""Length of the SHA-256 digest at the start of a program's file."""


def tune() -> Path | None:
    """Set this process up for a CPU.

    Call it before JAX computes anything. It never raises. In the environment, `SONARJAX_NO_CACHE=1` turns the
    compilation cache off, and `SONARJAX_CACHE_DIR` moves it.

    Returns:
        The cache folder; None if there is no cache.
    """
    use_quick_compiler()
    return enable_compilation_cache()


def use_quick_compiler() -> None:
    """Make XLA compile quickly for the CPU, unless the user's XLA_FLAGS say otherwise."""
    given = os.environ.get("XLA_FLAGS", "")
    wanted = [flag for flag in FLAGS if flag.partition("=")[0] not in given]
    if wanted:
        os.environ["XLA_FLAGS"] = " ".join([given, *wanted]).strip()


def enable_compilation_cache() -> Path | None:
    """Let JAX store compiled code on disk.

    By default it lies in the user's cache folder (`XDG_CACHE_HOME`, else `~/.cache`). A cache that the user has set up
    for JAX is left alone, and so are thresholds that are set for JAX. Compiled code is trusted code, for one type of
    processor, one number of cores and one JAX version. The folder belongs to the user, and may be deleted at any time.

    Returns:
        The folder in use; None if there is no cache, or JAX's is not a folder.
    """
    if _no_cache():
        return None
    if getattr(jax.config, _CACHE):
        return _cache_folder()
    folder = _writable_folder()
    if folder is None:
        return None
    jax.config.update(_CACHE, str(folder))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_COMPILE_SECONDS)
    return folder


def _no_cache() -> bool:
    """True if the user wants nothing to be stored."""
    return os.environ.get("SONARJAX_NO_CACHE", "").lower() not in _OFF


def _cache_folder() -> Path | None:
    """The folder of JAX's cache; None if there is none, it is not to be used, or it is elsewhere, as in gs://bucket."""
    chosen = getattr(jax.config, _CACHE)
    return Path(chosen) if chosen and "://" not in chosen and not _no_cache() else None


def keep_memory() -> bool:
    """Make this process keep the memory that it frees.

    This is for training. XLA's CPU backend allocates the buffers of each step anew (70 MB at width 16). The C library
    returns blocks of that size to the kernel, which zeroes them before it hands them out again: this can take a third
    of a step. Call it before the first step. Large pages help a little more, but can only be requested when a program
    starts: GLIBC_TUNABLES=glibc.malloc.hugetlb=1.

    Returns:
        True if that is possible, as with glibc.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):  # another C library
        return False
    return all([mallopt(name, value) == 1 for name, value in _MEMORY.items()])


class CpuEngine(Engine):
    """An engine with a thread for each core, and with programs that are traced once and then read from disk."""

    def __init__(self, folder: str | os.PathLike[str] | None = None) -> None:
        """Choose where traced programs are stored.

        Args:
            folder: Folder of the programs; None means next to the compilation cache, or nowhere if there is no cache.
        """
        compiled = _cache_folder()
        self._folder = Path(folder) if folder else compiled / "programs" if compiled else None
        self._programs: dict[Any, Future[Any]] = {}
        self._lock = threading.Lock()
        self._busy = threading.local()
        _register_results()

    @property
    def at_once(self) -> int:
        """How many items `map` processes at the same time: one for each core."""
        return cores()

    def run(self, function: Callable[..., Any], *args: Any, **static: Any) -> Any:
        """Call a function under `jax.jit`, with its traced program from disk if an earlier process stored it.

        A program is compiled only once, however many threads ask for it. Only functions of this package are stored. Any
        other function is just called, and so is every function without a folder or with a traced argument.

        Args:
            function: The function.
            *args: Its arguments.
            **static: Its static arguments, by name.

        Returns:
            What the function returns.
        """
        traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(args))
        if self._folder is None or traced or not _is_ours(function):
            return function(*args, **static)
        leaves, program = self._program(function, args, static)
        return program.result()(leaves)

    def prepare(self, function: Callable[..., Any], *args: Any, **static: Any) -> None:
        """Trace a function now for arguments of these shapes, and compile it in the background.

        Tracing in the background as well would be slower: Python traces on one thread at a time, while the compiler
        runs without Python. Nothing is done without a folder, or for a function that is not of this package.

        Args:
            function: The function under `jax.jit` that `run` will call.
            *args: Arguments of the same shapes and types.
            **static: Its static arguments, by name.
        """
        if self._folder is not None and _is_ours(function):
            self._program(function, args, static, wait=False)

    def _program(
        self, function: Any, args: Any, static: dict[str, Any], wait: bool = True
    ) -> tuple[list[Any], Future[Any]]:
        """The arguments' leaves, and the program for them, made here or by the thread that asked first."""
        leaves, tree = jax.tree.flatten(args)
        leaves = [leaf if hasattr(leaf, "dtype") else np.asarray(leaf, _plain_type(leaf)) for leaf in leaves]
        types = tuple((v.shape, str(v.dtype)) for v in leaves)
        key = (function, tree, types, tuple(sorted(static.items(), key=_name)), _traced_settings())
        with self._lock:
            known = self._programs.get(key)
            program: Future[Any] = known or self._programs.setdefault(key, Future())
        if known is None:
            with self._told(key, program):
                assert self._folder is not None
                lowered = _lowered(function, jax.tree.unflatten(tree, leaves), static, self._folder)
                if wait:
                    self._compile(key, program, lowered)
                else:
                    # Not a daemon thread: a compiler that is cut off when the interpreter ends crashes the process.
                    threading.Thread(target=self._compile, args=(key, program, lowered)).start()
        return leaves, program

    def _compile(self, key: Any, program: Future[Any], lowered: Any) -> None:
        with self._told(key, program):
            usual = not jax.config.read("jax_disable_most_optimizations")
            program.set_result(lowered.compile(compiler_options=COMPILER_OPTIONS if usual else None))

    @contextmanager
    def _told(self, key: Any, program: Future[Any]) -> Iterator[None]:
        """Pass an error on to all threads that wait for the program. The next call tries again.

        An interrupt is raised here too, because nobody may be waiting.
        """
        try:
            yield
        except BaseException as error:
            self._programs.pop(key, None)
            if not program.done():  # an interrupt may come after the result
                program.set_exception(error)
            if not isinstance(error, Exception):
                raise

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
        """Call a function for each item, with a thread for each core.

        Each thread waits until its results are computed. A `map` inside such a thread takes its items one by one.

        Args:
            function: Called with an item.
            items: The items.

        Returns:
            The results, in the order of the items.
        """
        items = list(items)
        if len(items) < 2 or cores() < 2 or getattr(self._busy, "inside", False):
            return [function(item) for item in items]

        def one(item: Any) -> Any:
            self._busy.inside = True
            return jax.block_until_ready(function(item))

        with ThreadPoolExecutor(min(cores(), len(items))) as pool:
            return list(pool.map(one, items))

    def stream(self, function: Callable[[Any, Any, Engine], Any], shared: Any, items: Iterable[Any]) -> Iterator[Any]:
        """Yield the result for each item, computed by a thread for each core.

        The first item runs alone, because it compiles for the others.

        Args:
            function: Called as `function(shared, item, engine)`, here with this engine.
            shared: First argument of every call.
            items: Second argument of each call. They are read as they are needed, a few in advance.

        Yields:
            The results, in the order of the items.
        """
        rest = iter(items)
        for first in rest:
            yield function(shared, first, self)
            break
        pool = ThreadPoolExecutor(cores())
        try:
            waiting = deque(pool.submit(function, shared, item, self) for item in islice(rest, 2 * cores()))
            while waiting:
                done = waiting.popleft().result()
                waiting.extend(pool.submit(function, shared, item, self) for item in islice(rest, 1))
                yield done
        finally:  # an interrupt does not wait for what was only submitted
            pool.shutdown(cancel_futures=True)


def usual_engine() -> Engine:
    """Make the engine with which entry points compute.

    Returns:
        A `CpuEngine` on a CPU, an `Engine` (plain JAX) on an accelerator.
    """
    return CpuEngine() if jax.default_backend() == "cpu" else Engine()


def cores() -> int:
    """Count the cores that this process may use.

    Returns:
        Number of cores.
    """
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _name(item: tuple[str, Any]) -> str:
    return item[0]


def _plain_type(value: Any) -> Any:
    """The type that JAX gives to a plain Python number."""
    return np.bool_ if isinstance(value, bool) else np.int32 if isinstance(value, int) else np.float32


def _is_ours(function: Any) -> bool:
    """Whether a function's name and the package's source say what it computes.

    Two closures share one name, and the code of a user's function may change.
    """
    return str(function.__module__).startswith("sonarjax.") and "<" not in getattr(function, "__qualname__", "<")


def _lowered(function: Callable[..., Any], args: Any, static: dict[str, Any], folder: Path) -> Any:
    """Lower the function of a flat list of leaves: read it from an earlier process's file, or trace it now."""
    leaves, tree = jax.tree.flatten(args)

    def of_leaves(values: list[Any]) -> Any:
        return function(*jax.tree.unflatten(tree, values), **static)

    path = folder / f"{_digest(function, tree, leaves, static)}.bin"
    stored = _read(path)
    if stored is None:
        stored = export.export(jax.jit(of_leaves))([jax.ShapeDtypeStruct(v.shape, v.dtype) for v in leaves])
        _write(path, stored)
    return jax.jit(stored.call).lower(leaves)


def _digest(function: Any, tree: Any, leaves: list[Any], static: dict[str, Any]) -> str:
    """A name for one program, from the function, the types of its arguments, and the code and versions behind it."""
    facts = (
        f"{function.__module__}.{function.__qualname__}", str(tree), [(v.shape, str(v.dtype)) for v in leaves],
        sorted((name, repr(value)) for name, value in static.items()), _traced_settings(), _versions(),
        _source_digest(), os.environ.get("XLA_FLAGS", ""), jax.default_backend(),
    )  # fmt: skip
    return hashlib.sha256(repr(facts).encode()).hexdigest()[:32]


def _traced_settings() -> tuple[Any, ...]:
    """The values of `_SETTINGS` now."""
    return tuple(getattr(jax.config, name, None) for name in _SETTINGS)  # a later JAX may drop one


@cache
def _versions() -> tuple[str, ...]:
    """The versions of `_LIBRARIES`."""
    return tuple(metadata.version(name) for name in _LIBRARIES)


@cache
def _source_digest() -> str:
    """A digest of the package's source code, so that a program of other code is not used."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _read(path: Path) -> Any:
    """The program in a file; None if there is none or it is incomplete, in which case it is traced again."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    digest, program = data[:DIGEST_BYTES], data[DIGEST_BYTES:]
    return export.deserialize(bytearray(program)) if hashlib.sha256(program).digest() == digest else None


def _write(path: Path, program: Any) -> None:
    """Store a program behind its digest. If it cannot be written, the computation continues without."""
    data = program.serialize()
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_atomic(path, lambda file: file.write(hashlib.sha256(data).digest() + data))
    except (OSError, SonarjaxError):
        return


@cache
def _register_results() -> None:
    """Tell JAX under which names the records that programs return are stored in its files."""
    export.register_namedtuple_serialization(BankViews, serialized_name="sonarjax.BankViews")
    for record in (PoseEstimate, Pose, Drawn, EchoLaw, Evidence):
        export.register_pytree_node_serialization(
            record,
            serialized_name=f"sonarjax.{record.__name__}",
            serialize_auxdata=_names_to_bytes,
            deserialize_auxdata=_names_of_bytes,
        )


def _names_to_bytes(aux: tuple[tuple[str, ...], ...]) -> bytes:
    """A record's static fields, which hold names, as text."""
    return "\n".join(" ".join(names) for names in aux).encode()


def _names_of_bytes(data: bytes) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(line.split()) for line in data.decode().splitlines())


def _writable_folder() -> Path | None:
    """The folder for this JAX version, processor and number of cores, made if needed; None if it cannot be written.

    XLA divides a program among the cores that it sees while it compiles, and JAX's key does not count them: code that
    was compiled on one core would never use more, and its sums are rounded differently.
    """
    try:
        folder = _root() / f"jax-{jax.__version__}-{_processor()}-{cores()}"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        return folder if os.access(folder, os.W_OK | os.X_OK) else None
    except (OSError, RuntimeError, ValueError):  # RuntimeError: no home; ValueError: a null byte in a path
        return None


def _root() -> Path:
    chosen = os.environ.get("SONARJAX_CACHE_DIR")
    if chosen:
        return Path(chosen).expanduser().absolute()
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (base if base.is_absolute() else Path.home() / ".cache") / "sonarjax" / "xla"


def _processor() -> str:
    """Eight hex digits for the instruction set, because machines of several kinds may share a home folder.

    On a CPU, XLA compiles for the machine on which it runs. Loading that code on another machine prints long errors at
    best.
    """
    features = platform.machine() + platform.processor()
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            features += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    except OSError:
        pass  # not Linux: the name of the machine must suffice
    return hashlib.sha256(features.encode()).hexdigest()[:8]
