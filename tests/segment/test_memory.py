"""Memory kept from step to step: counted in the kernel's own page faults, in a process of its own."""

from __future__ import annotations

import subprocess
import sys

import pytest

COUNT = """
import ctypes, resource, threading
from sonarjax.segment.memory import keep_memory
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


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's settings")
def test_a_freed_block_is_used_again_without_faults() -> None:
    (_, without), (said, count) = faults(False), faults(True)
    if said == "False":
        pytest.skip("not glibc")
    assert count < 0.4 * without  # once for the first of five blocks, with pages of any size
