"""Keeping the memory of one training step for the next: on Linux a third of a step can go into asking for it again.

XLA's CPU allocates what a step needs anew each time (70 MB at width 16), and the C library gives blocks of that size
back to the kernel, which hands them out again zeroed, page by page.
"""

from __future__ import annotations

import ctypes
import sys

# <malloc.h>: M_ARENA_MAX, M_MMAP_MAX, M_TRIM_THRESHOLD and M_TOP_PAD.
_SETTINGS = {-8: 1, -4: 0, -1: 2**31 - 1, -2: 256 * 2**20}


def keep_memory() -> bool:
    """Have this process keep the memory that it frees; True where that is possible (glibc).

    For programs that train: the process stays as large as its largest step was. Call it before the first step. Large
    pages help a little more, but can only be asked for as a program starts: GLIBC_TUNABLES=glibc.malloc.hugetlb=1.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):  # another C library
        return False
    return all([mallopt(name, value) == 1 for name, value in _SETTINGS.items()])
