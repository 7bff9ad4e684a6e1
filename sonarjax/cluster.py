"""Share work among the workers of a Dask cluster: optional, used only by entry points (extra `cluster`).

`connect("local:4")` or `connect("tcp://host:8786")` gives an engine whose `stream` runs in other processes. Results
come in the order of the items, and are the same as those of one process. What a killed worker was computing is computed
again by another. Workers need the same packages. They need not share a file system, because arguments and results
travel through Dask.
"""

from __future__ import annotations

import json
import re
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from itertools import islice
from typing import Any

from sonarjax.cpu import CpuEngine, cores, tune
from sonarjax.engine import Engine
from sonarjax.io.console import complain
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import read_bytes, reason

DEATHS = 1000
"""How many workers may die at one item before it is given up; they may be killed for unrelated reasons."""
CONNECT_S = 10
"""How long to wait for a scheduler [s]."""
ADDRESS = re.compile(r"[a-z]+://\S+|\S+:[0-9]+")
"""The address of a scheduler."""
PATIENCE_S = 10
"""How often to look whether any workers are left [s]."""
AHEAD = 2
"""Number of items that are submitted for each thread of the workers."""


class ClusterEngine(CpuEngine):
    """An engine that streams over the workers of a cluster; everything else runs here, as with `CpuEngine`."""

    def __init__(self, client: Any) -> None:
        """Stream over the workers of a Dask client.

        Args:
            client: A `distributed.Client`.
        """
        super().__init__()
        self.client = client
        self._noted = False

    def threads(self) -> int:
        """Count the threads of all present workers.

        Returns:
            Number of threads.
        """
        return sum(self.client.nthreads().values())

    def stream(self, function: Callable[[Any, Any, Engine], Any], shared: Any, items: Iterable[Any]) -> Iterator[Any]:
        """Yield the result for each item, computed by the workers of the cluster.

        The first item runs alone, because its worker compiles for the others on its machine.

        Args:
            function: Called as `function(shared, item, engine)` on a worker, with the worker's own engine. It must be
                defined in a module.
            shared: First argument of every call.
            items: Second argument of each call. They are read as they are needed, a few in advance.

        Yields:
            The results, in the order of the items.

        Raises:
            SonarjaxError: The scheduler is gone or dropped the work, or too many workers died at one item.
            Exception: Whatever `function` raises.
        """
        from distributed import CancelledError, KilledWorker

        # Submitted as a task, not scattered as data, so that Dask makes it again if the worker that held it is killed.
        kept = self.client.submit(_same, shared, pure=False)
        rest = iter(items)

        def start(item: Any) -> tuple[Any, Any]:
            return item, self.client.submit(_on_worker, function, kept, item, pure=False)

        waiting = deque(start(item) for item in islice(rest, 1))
        first = True
        while waiting:
            item, future = waiting.popleft()
            for _ in range(DEATHS):
                try:
                    done = self._result(future)
                    break
                except KilledWorker:  # the scheduler has given the item up, but we try again
                    kept = self.client.submit(_same, shared, pure=False)
                    future = start(item)[1]
                except CancelledError as error:
                    raise SonarjaxError("--cluster: the scheduler stopped, or it dropped the work") from error
            else:
                raise SonarjaxError(f"--cluster: {DEATHS} workers died while they computed the same item")
            room = AHEAD * max(1, self.threads()) if first else 1
            first = False
            waiting.extend(start(one) for one in islice(rest, room))
            yield done

    def _result(self, future: Any) -> Any:
        """The result of a task; while it waits without any worker, one line says so."""
        while True:
            try:
                return future.result(timeout=None if self._noted else PATIENCE_S)
            except TimeoutError:
                if future.done():  # raised by the task itself
                    raise
                if not self.client.nthreads():
                    same = "do workers have the same packages as this machine?"
                    complain(f"--cluster: no workers are left: waiting for one ({same})", kind="")
                    self._noted = True


def _same(value: Any) -> Any:
    return value


def _on_worker(function: Callable[[Any, Any, Engine], Any], shared: Any, item: Any) -> Any:
    """On a worker: call `function(shared, item, engine)` with the worker's own engine."""
    return function(shared, item, _own_engine())


@cache
def _own_engine() -> CpuEngine:
    tune()  # before JAX computes anything in this process
    return CpuEngine()


@contextmanager
def connect(address: str) -> Iterator[ClusterEngine]:
    """Connect to a Dask cluster for the length of a `with` block.

    Args:
        address: The address of a scheduler, the path of its file (*.json), or `local[:N]`, which starts N worker
            processes (default: one for each core) and ends them afterwards.

    Yields:
        An engine that streams over the workers of the cluster.

    Raises:
        SonarjaxError: `address` is none of these, nobody answers there, the scheduler's file is missing or is not
            one, or the package `distributed` is missing.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise SonarjaxError("--cluster: Dask is not installed: pip install 'sonarjax[cluster]'") from error
    match = re.fullmatch(r"local(?::([0-9]{1,4}))?", address)
    if match is None and not (ADDRESS.fullmatch(address) or address.endswith(".json")):
        raise SonarjaxError(
            f"--cluster: expected local, local:N, a scheduler's address such as tcp://host:8786, or the path of its "
            f"scheduler.json, got {address!r}"
        )
    workers = int(match[1]) if match and match[1] else cores()
    if workers < 1:
        raise SonarjaxError("--cluster: expected local:N with N of 1 or more")
    with dask.config.set(
        {"distributed.scheduler.allowed-failures": DEATHS, "distributed.logging.distributed": "error"}
    ):
        if match:
            with _deaf_to_interrupts():
                cluster = LocalCluster(
                    n_workers=workers, threads_per_worker=1, dashboard_address=None, memory_limit=0, silence_logs=50
                )
            with cluster, Client(cluster) as client:
                yield ClusterEngine(client)
            return
        scheduler = _address_in(address) if address.endswith(".json") else address
        try:
            client = Client(scheduler, timeout=CONNECT_S)
        except (OSError, ValueError, TimeoutError, TypeError, AssertionError) as error:
            raise SonarjaxError(f"--cluster: no scheduler answers at {address}: {reason(error)[:120]}") from error
        with client:
            if not client.nthreads():
                complain("--cluster: the scheduler has no workers yet: waiting for the first", kind="")
            yield ClusterEngine(client)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C here, and in processes that are started meanwhile: a terminal sends it to them as well.

    Workers would each print a traceback; the cluster ends them.
    """
    if threading.current_thread() is not threading.main_thread():  # where no signal can be ignored
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _address_in(path: str) -> str:
    """The address in a scheduler's file; Dask itself would wait for ever for a file that is not there."""
    try:
        found = json.loads(read_bytes(path))
    except SonarjaxError as error:
        raise SonarjaxError(f"--cluster: {error}") from error
    except (ValueError, RecursionError) as error:
        raise SonarjaxError(f"--cluster: {path}: expected the JSON file that a Dask scheduler writes") from error
    address = found.get("address") if isinstance(found, dict) else None
    if not isinstance(address, str) or not ADDRESS.fullmatch(address):
        raise SonarjaxError(f"--cluster: {path}: address: expected that of a Dask scheduler")
    return address
