"""Run tasks on the workers of a Dask cluster (https://distributed.dask.org): the pool `ClusterPool`.

Work, items and results travel as Dask sends them. Whoever may connect to a scheduler runs code on its workers
and on this machine: away from this machine both sides show TLS certificates, which Dask reads from its own
configuration.
"""

import hashlib
import logging
import math
import platform
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from needlefit.errors import ConfigError, UnfinishedWorkError
from needlefit.project.callbacks import Note, Stop, never_stop, no_note
from needlefit.project.tasks import as_finished, read_work, stop_tasks

if TYPE_CHECKING:
    from distributed import Client, Future

Item = TypeVar("Item")
Result = TypeVar("Result")

CONNECT_S = 10.0  # longest time (s) that a scheduler may take to answer
CLOSE_S = 2.0  # longest time (s) that closing the connection may take: the scheduler may be lost
COUNT_WORKERS_S = 1.0
"""Shortest time (s) between two counts of the workers: each count sends the addresses of all of them here."""

# number of tasks at the scheduler for each worker: one that runs, and one that follows it at once
TASKS_PER_WORKER = 2
CHECKED_PACKAGES = ("numpy", "scipy", "nlopt", "emcee", "trimesh")
"""Packages that results depend on; their versions are equal everywhere."""

_ONE_AT_A_TIME = threading.Lock()
"""Lock of a worker of several threads, which runs one task at a time: limits of linear algebra hold for a
whole process."""


@dataclass(frozen=True)
class ClusterPool:
    """The workers of a scheduler; `note` is given a line where none is connected."""

    client: "Client"
    note: Note = no_note

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item], stop: Stop = never_stop
    ) -> Iterator[tuple[int, Result]]:
        """Yield results as they are finished: see `TaskPool.run`. A stop drops the tasks that run.

        UnfinishedWorkError if the scheduler is lost, a worker has other versions, or a task ended several
        workers.
        """
        from distributed.protocol.pickle import dumps  # also functions of a script

        code = describe_code()
        running: set[Future[Result]] = set()
        # as a task, so that it is sent again to a worker that comes later; as bytes: tasks change their work
        shared = self.client.submit(_keep, dumps(work), pure=False)
        wanted, count_at = 0, -math.inf

        def submit(n: int) -> "Future[Result]":
            future = self.client.submit(_run_task, shared, items[n], code, pure=False)
            running.add(future)
            return future

        def count_wanted() -> int:
            nonlocal wanted, count_at
            if time.monotonic() >= count_at:
                before, count = wanted, self._count_workers()
                if not (count or before):
                    self.note("no worker is connected to the scheduler; waiting for one")
                wanted = TASKS_PER_WORKER * max(1, count)
                count_at = time.monotonic() + COUNT_WORKERS_S
            return wanted

        try:
            for n, future in as_finished(submit, len(items), count_wanted, stop, drop=True):
                running.remove(future)
                yield n, _result_of(future)
        finally:
            if self.client.status == "running":
                with suppress(OSError):  # lost just now: nothing is left to cancel
                    self.client.cancel([*running, shared], force=True)

    def _count_workers(self) -> int:
        """Return how many workers are connected; UnfinishedWorkError if the scheduler is lost."""
        if self.client.status != "running":
            raise _lost_scheduler()
        try:
            # `scheduler_info` of some releases lists five workers only
            return len(self.client.nthreads())
        except OSError:
            raise _lost_scheduler() from None


def _result_of(future: "Future[Result]") -> Result:
    from concurrent.futures import CancelledError

    from distributed.scheduler import KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        raise UnfinishedWorkError(
            f"a task ended {error.last_worker.address if error.last_worker else 'its worker'} and others",
            expected="workers with memory for a task",
            fix="give each worker more memory, then go on with --resume",
            where="a worker of the cluster",
        ) from None
    except (CancelledError, OSError):
        raise _lost_scheduler() from None


def _lost_scheduler() -> UnfinishedWorkError:
    return UnfinishedWorkError(
        "the scheduler of the cluster was lost",
        expected="a running scheduler",
        fix="start it again, then go on with --resume: finished tasks are kept",
    )


@contextmanager
def connect_cluster(scheduler: str, insecure: bool = False, note: Note = no_note) -> Iterator[ClusterPool]:
    """Connect to a scheduler, `tls://HOST:PORT` or on this machine `tcp://HOST:PORT`; disconnect in the end.

    `insecure` also accepts an unencrypted scheduler on another machine. ConfigError if the address is wrong
    or not secured, or nobody answers.
    """
    from distributed import Client
    from distributed.utils import silence_logging_cmgr

    require_secured(scheduler, insecure)
    with silence_logging_cmgr(logging.CRITICAL):  # it logs a traceback where a connection is lost
        try:
            client = Client(scheduler, timeout=CONNECT_S)
        except (OSError, TimeoutError, ValueError, TypeError) as error:
            raise ConfigError(
                f"no scheduler answers: {error}",
                expected="a running Dask scheduler; for tls://, certificates in Dask's configuration",
                fix="start one with `dask scheduler`; see docs/developers/scale.md",
                where=f"--scheduler {scheduler}",
            ) from None
        try:
            yield ClusterPool(client, note)
        finally:
            client.close(timeout=CLOSE_S)


_THIS_MACHINE = ("localhost", "127.0.0.1", "[::1]")


def require_secured(scheduler: str, insecure: bool = False) -> None:
    """Raise a ConfigError unless an address is encrypted, or of this machine, or `insecure` accepts it."""
    host = scheduler.partition("://")[2].rpartition(":")[0]
    if not (scheduler.startswith("tls://") or insecure or host in _THIS_MACHINE):
        raise ConfigError(
            "is not encrypted: whoever can reach it could run code on its workers",
            expected="tls://HOST:PORT with certificates, or an address of this machine",
            fix="use tls://, or --insecure on a network that nobody else can reach",
            where=f"--scheduler {scheduler}",
        )


def _keep(data: bytes) -> bytes:
    return data


def _run_task(data: bytes, item: object, code: dict[str, str]) -> Any:  # noqa: ANN401 - of any work
    """Return on a worker what the work makes of an item; UnfinishedWorkError if its versions are others."""
    here = describe_code()
    other = [f"{name} {here[name]} instead of {value}" for name, value in code.items() if here[name] != value]
    if other:
        raise UnfinishedWorkError(
            f"a worker has {', '.join(other)}",
            expected="the versions of this machine",
            fix="install them on all workers",
            where=f"worker {platform.node()}",
        )
    with _ONE_AT_A_TIME:
        _limit_worker()
        stop_tasks(_watch_task())
        return read_work(data)(item)


def _watch_task() -> Stop:
    """Return what finds out whether the task of this thread of a worker was cancelled."""
    from distributed import get_worker

    tasks, key = get_worker().state.tasks, get_worker().get_current_task()
    return lambda: key not in tasks or tasks[key].state == "cancelled"


@cache
def _limit_worker() -> None:
    import scipy.linalg  # noqa: F401  only what is loaded is limited
    from threadpoolctl import threadpool_limits

    threadpool_limits(1, user_api="blas")


@cache
def describe_code() -> dict[str, str]:
    """Return what results depend on: the digest of this package's code, and the versions of others."""
    package, digest = Path(__file__).parent.parent, hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    versions = {name: version(name) for name in ("needlefit", *CHECKED_PACKAGES)}
    return {"Python": platform.python_version(), **versions, "code": digest.hexdigest()[:16]}
