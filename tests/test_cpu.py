"""`sonarjax.cpu`: flags that leave the user's alone, an engine that gives what plain JAX gives, memory that is kept."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from concurrent.futures import Future
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax import cpu
from sonarjax.engine import PLAIN


@partial(jax.jit, static_argnames="count")
def powers(x, *, count):
    return jnp.stack([x**k for k in range(count)])


powers.__module__ = "sonarjax.powers"  # as a function of the package, because no other is stored


# ---------------------------------------------------------------- flags


@pytest.mark.skipif(not cpu.FLAGS, reason="this JAX needs none")
@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("", cpu.FLAGS[0] if cpu.FLAGS else ""),
        ("--xla_other=1", f"--xla_other=1 {cpu.FLAGS[0] if cpu.FLAGS else ''}"),
        ("--xla_cpu_use_fusion_emitters=true", "--xla_cpu_use_fusion_emitters=true"),
    ],
)
def test_flags_are_added_unless_the_user_gave_them(given, wanted, monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", given)
    for _ in range(2):  # once is enough
        cpu.use_quick_compiler()
        assert os.environ["XLA_FLAGS"] == wanted


# ---------------------------------------------------------------- the engine


def test_it_gives_what_plain_jax_gives_and_is_read_from_disk_the_next_time(tmp_path, monkeypatch):
    x = jnp.arange(3.0)
    wanted = PLAIN.run(powers, x, count=4)
    np.testing.assert_array_equal(cpu.CpuEngine(tmp_path).run(powers, x, count=4), wanted)
    (file,) = tmp_path.glob("*.bin")
    monkeypatch.setattr(jax.export, "export", None)  # nothing may be traced again
    np.testing.assert_array_equal(cpu.CpuEngine(tmp_path).run(powers, x, count=4), wanted)
    monkeypatch.undo()
    file.write_bytes(file.read_bytes()[:40])  # cut short: traced again
    np.testing.assert_array_equal(cpu.CpuEngine(tmp_path).run(powers, x, count=4), wanted)


@partial(jax.jit, static_argnames="count")
def noise(key, *, count):
    return jax.random.uniform(jax.random.wrap_key_data(key), (count,))


noise.__module__ = "sonarjax.noise"


def test_a_program_of_other_random_numbers_is_not_used(tmp_path):
    """Neither of this process nor of an earlier one: how bits are drawn becomes part of the program."""
    key, engine = jax.random.key_data(jax.random.key(0)), cpu.CpuEngine(tmp_path)
    for partitionable in (False, True):
        with jax.threefry_partitionable(partitionable):
            wanted = np.asarray(PLAIN.run(noise, key, count=8))
            for each in (engine, cpu.CpuEngine(tmp_path)):
                np.testing.assert_array_equal(each.run(noise, key, count=8), wanted)
    assert len(list(tmp_path.glob("*.bin"))) == 2


def test_programs_are_stored_nowhere_if_nothing_is_to_be_or_the_cache_is_no_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = jax.config.jax_compilation_cache_dir
    try:
        jax.config.update("jax_compilation_cache_dir", "gs://bucket/cache")
        assert cpu.CpuEngine()._folder is None and cpu.enable_compilation_cache() is None
        jax.config.update("jax_compilation_cache_dir", str(tmp_path))
        assert cpu.CpuEngine()._folder == tmp_path / "programs"
        monkeypatch.setenv("SONARJAX_NO_CACHE", "1")
        assert cpu.CpuEngine()._folder is None and cpu.CpuEngine(tmp_path)._folder == tmp_path
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def test_plain_numbers_pass_as_they_do_through_jit(tmp_path):
    found = cpu.CpuEngine(tmp_path).run(powers, 2.0, count=3)
    np.testing.assert_array_equal(found, [1.0, 2.0, 4.0])
    assert found.dtype == jnp.float32


def test_a_folder_may_be_named_by_text(tmp_path):
    cpu.CpuEngine(str(tmp_path)).run(powers, jnp.arange(3.0), count=2)
    assert len(list(tmp_path.glob("*.bin"))) == 1


def times(factor):
    return jax.jit(lambda x: x * factor)


def closure(factor):
    def scaled(x):
        return x * factor

    scaled.__module__ = "sonarjax.powers"
    return jax.jit(scaled)


def user_function(factor):
    """As a script that is edited between two runs: another function of the same name."""
    code: dict = {"__name__": "script"}
    exec(f"def scaled(x): return x * {factor}", code)
    return jax.jit(code["scaled"])


@pytest.mark.parametrize("make", [times, closure, user_function, lambda c: partial(jnp.multiply, c)])
def test_only_functions_of_the_package_are_stored(make, tmp_path):
    for factor in (2.0, 3.0):
        engine = cpu.CpuEngine(tmp_path)
        engine.prepare(make(factor), np.float32(1.0))
        assert float(engine.run(make(factor), np.float32(1.0))) == factor
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("unoptimised", "wanted"), [(False, cpu.COMPILER_OPTIONS), (True, None)])
def test_jax_s_own_setting_goes_before_the_engine_s_options(unoptimised, wanted, tmp_path, monkeypatch):
    options = []

    class Lowered:
        def compile(self, compiler_options):
            options.append(compiler_options)
            return sum

    monkeypatch.setattr(cpu, "_lowered", lambda *_: Lowered())
    jax.config.update("jax_disable_most_optimizations", unoptimised)  # set again before the next test
    assert float(cpu.CpuEngine(tmp_path).run(powers, 2.0, count=3)) == 2.0
    assert options == [wanted]


def test_an_interrupt_ends_what_nobody_waits_for(tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    engine = cpu.CpuEngine(tmp_path)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(cpu, "_lowered", interrupted)
        engine.prepare(powers, 2.0, count=3)
    assert engine.run(powers, 2.0, count=3)[2] == 4.0  # the next call tries again


def test_inside_a_trace_it_is_a_plain_call(tmp_path):
    engine = cpu.CpuEngine(tmp_path)
    slope = jax.grad(lambda x: engine.run(powers, x, count=3).sum())(2.0)
    assert float(slope) == pytest.approx(5.0)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_does_not_matter(tmp_path):
    (tmp_path / "file").write_text("in the way")
    found = cpu.CpuEngine(tmp_path / "file" / "programs").run(powers, jnp.arange(3.0), count=2)
    np.testing.assert_array_equal(found, powers(jnp.arange(3.0), count=2))


def test_map_keeps_the_order_spreads_and_does_not_nest(tmp_path, monkeypatch):
    monkeypatch.setattr(cpu, "cores", lambda: 2)
    engine, threads = cpu.CpuEngine(tmp_path), set()

    def inner(k):
        threads.add(threading.get_ident())
        return jnp.float32(k)

    assert [float(v) for v in engine.map(inner, range(5))] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert threading.get_ident() not in threads

    def outer(k):
        here = threading.get_ident()
        threads.clear()
        found = engine.map(inner, range(3))
        return here, found

    here, found = engine.map(outer, [0, 1])[0]
    assert [float(v) for v in found] == [0.0, 1.0, 2.0] and here != threading.get_ident()


def test_an_error_in_one_item_is_raised(tmp_path, monkeypatch):
    monkeypatch.setattr(cpu, "cores", lambda: 2)

    def fail(k):
        raise ValueError(f"item {k}")

    with pytest.raises(ValueError, match="item 0"):
        cpu.CpuEngine(tmp_path).map(fail, range(3))


# ---------------------------------------------------------------- importing changes nothing

SHOW = """
import os, jax
before = dict(os.environ), jax.config.jax_compilation_cache_dir
import sonarjax, sonarjax.cpu
assert (dict(os.environ), jax.config.jax_compilation_cache_dir) == before
"""


def test_importing_the_package_sets_nothing():
    kept = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS" and not k.startswith("JAX_COMPILATION")}
    project = Path(__file__).resolve().parent.parent
    subprocess.run([sys.executable, "-c", SHOW], env=kept, cwd=project, check=True, timeout=120)


# ---------------------------------------------------------------- memory: counted in the kernel's own page faults

COUNT = """
import ctypes, resource, threading
from sonarjax.cpu import keep_memory
print(keep_memory() if {keep} else False)
libc = ctypes.CDLL(None)
libc.malloc.restype, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
def use():
    for _ in range(5):
        block = libc.malloc(ctypes.c_size_t(80 * 2**20))
        ctypes.memset(block, 1, 80 * 2**20)
        libc.free(block)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
thread = threading.Thread(target=use)  # as XLA does: it runs a step in a thread of its own
thread.start(); thread.join()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(keep: bool) -> tuple[str, int]:
    code = COUNT.format(keep=keep)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    said, count = done.stdout.split()
    return said, int(count)


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's settings")
def test_a_freed_block_is_used_again_without_faults() -> None:
    (_, without), (said, count) = faults(False), faults(True)
    if said == "False":
        pytest.skip("not glibc")
    assert count < 0.4 * without  # once for the first of five blocks, with pages of any size


def test_an_interrupt_after_the_result_is_the_interrupt(tmp_path):
    """A program that is known already cannot fail any more, but the caller still hears of the interrupt."""
    engine, program = cpu.CpuEngine(tmp_path), Future()
    with pytest.raises(KeyboardInterrupt), engine._told("key", program):
        program.set_result(sum)
        raise KeyboardInterrupt
    assert program.result() is sum
