"""JAX's persistent compilation cache, so that a second run starts at once.

Takes its place from the environment, returns the folder it set. Compiled code is only loaded by the processor type and
the JAX version that wrote it, and it is trusted code: the folder is the user's own. It may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import os
import platform
from pathlib import Path

import jax

MIN_COMPILE_SECONDS = 0.2  # [s] below this, reading a file back gains nothing

_SETTING = "jax_compilation_cache_dir"
_OFF = ("", "0", "false", "no")


def enable_compilation_cache() -> Path | None:
    """Let JAX keep compiled code on disk; returns the folder in use, or None where there is no cache.

    `SONARJAX_NO_CACHE=1` turns it off, `SONARJAX_CACHE_DIR` moves it; by default it lies in the user's cache folder
    (`XDG_CACHE_HOME`, else `~/.cache`). A cache that the user set up for JAX is left as it is, and so are JAX's own
    thresholds where they are set. Never raises: where nothing can be written, there is no cache.
    """
    if os.environ.get("SONARJAX_NO_CACHE", "").lower() not in _OFF:
        return None
    chosen = getattr(jax.config, _SETTING)
    if chosen:
        return Path(chosen)
    folder = _writable_folder()
    if folder is None:
        return None
    jax.config.update(_SETTING, str(folder))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_COMPILE_SECONDS)
    return folder


def _writable_folder() -> Path | None:
    """The folder of this JAX and this processor, made if need be; None where it cannot be written."""
    try:
        folder = _root() / f"jax-{jax.__version__}-{_processor()}"
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
    """Eight hex digits for the instruction set: a home folder may be shared by machines of several kinds.

    XLA on a CPU compiles for the machine it runs on. Loading that code elsewhere prints long errors at best.
    """
    features = platform.machine() + platform.processor()
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            features += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    except OSError:
        pass  # not Linux: the name of the machine has to do
    return hashlib.sha256(features.encode()).hexdigest()[:8]
