"""Workers of a sweep: a local Dask cluster that only this sweep can use, or a Dask scheduler."""

import fcntl
import gc
import logging
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

MISSING = "the package {} is not installed; install it with `pip install distributed scipy cryptography pyarrow`"
LOOPBACK = "127.0.0.1"
MAX_JOBS = 256
SCRATCH = "train_ato_sweep_"
"""Begin of the name of the temporary folder of local workers."""
OWNER = "owner.lock"
"""File in it that the process of the sweep has locked until its end, also that by SIGKILL."""
SCHEDULER_S = 10.0
"""Longest wait for the answer of a scheduler [s]."""
WORKERS_S = 30.0
"""Longest wait for the first worker of a scheduler [s]."""
CLOSE_S = 5.0
"""Longest wait for the end of the local workers [s]."""
SETTINGS = {
    "distributed.scheduler.allowed-failures": 1,  # of the workers of a batch, before its points run alone
    "distributed.scheduler.worker-ttl": "60s",  # a worker without a sign of life for longer is ended and replaced
    "distributed.deploy.lost-worker-timeout": "1 day",  # on a busy machine a new worker needs more than the default
    "distributed.comm.timeouts.connect": "120s",
    # without the profiler and the frequent checks of the event loop, which take processor time in every process
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.limit": "1h",
    "distributed.admin.system-monitor.interval": "5s",
}
"""Settings of Dask."""
LOGGERS = ("distributed", "bokeh", "tornado", "asyncio")
"""Loggers of Dask, whose messages are not for users of a sweep."""


@contextmanager
def sweep_client(scheduler: str | None, jobs: int | None, *, dashboard: bool = False) -> Iterator[Any]:
    """Yield a Dask client; local workers end with the block.

    Parameters
    ----------
    scheduler
        Address ``tcp://HOST:PORT`` of a scheduler with workers; None: local workers.
    jobs
        Number of local workers; None: one for each core.
    dashboard
        Serve the dashboard of the local scheduler; any user of this machine can read it.

    Raises
    ------
    ValueError
        If Dask, cryptography or pyarrow is not installed, or the scheduler does not answer or has no worker.
    """
    try:
        import dask
        import distributed  # noqa: F401
        import pyarrow  # noqa: F401

        if scheduler is None:
            import cryptography  # noqa: F401
    except ImportError as error:
        raise ValueError(f"sweep: {MISSING.format(error.name)}") from None
    gc.collect()  # Dask hangs if a client that found no scheduler is collected while the next one starts
    quiet = {"logging": dict.fromkeys(LOGGERS, "critical")}
    before = {name: logging.getLogger(name).level for name in LOGGERS}
    for name in LOGGERS:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        chosen = _remote(scheduler) if scheduler is not None else _local(jobs or cores, dashboard=dashboard)
        with dask.config.set({**quiet, **SETTINGS}), chosen as client:
            yield client
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


@contextmanager
def _remote(scheduler: str) -> Iterator[Any]:
    """Yield a client of a running scheduler."""
    from distributed import Client
    from distributed import TimeoutError as NoAnswer  # in Python 3.10 not the TimeoutError of Python
    from distributed.comm import get_address_host_port

    try:
        get_address_host_port(scheduler)  # before the client: one with a wrong address prints a traceback at its end
    except (ValueError, ImportError, NotImplementedError) as error:
        raise ValueError(f"--scheduler {scheduler}: {error}; write tcp://HOST:PORT") from None
    try:
        client = Client(scheduler, timeout=SCHEDULER_S, set_as_default=False)
    except (OSError, NoAnswer, ValueError, TypeError, ImportError) as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise ValueError(
            f"--scheduler {scheduler}: no Dask scheduler answers ({reason}); start one with `dask scheduler`"
        ) from None
    try:
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except NoAnswer:
            raise ValueError(
                f"--scheduler {scheduler}: has no worker; start one with `dask worker {scheduler} --nthreads 1`"
            ) from None
        yield client
    finally:
        with suppress(Exception):
            client.close(timeout=CLOSE_S)


@contextmanager
def _local(jobs: int, *, dashboard: bool) -> Iterator[Any]:
    """Yield a client of new worker processes, which listen on the loopback address only.

    A Dask scheduler executes code of every client. Every connection needs the temporary key of this sweep, which is in
    the memory of its processes only.
    """
    import dask
    from distributed import Client, LocalCluster
    from distributed.security import Security

    with _scratch_folder() as scratch, _main_not_imported():
        pages: dict[str, list[str]] = {"distributed.worker.http.routes": []}
        pages |= {} if dashboard else {"distributed.scheduler.http.routes": []}
        # The Ctrl-C of the terminal is for this process alone; the workers inherit the mask, also later ones.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
        try:
            with dask.config.set({"temporary-directory": scratch, **pages}):
                cluster = LocalCluster(
                    n_workers=jobs, threads_per_worker=1, processes=True, host=LOOPBACK, protocol="tls://",
                    security=Security.temporary(), dashboard_address=f"{LOOPBACK}:0",
                    worker_dashboard_address=None, scheduler_kwargs={"dashboard": dashboard},
                    local_directory=scratch, memory_limit=0, silence_logs=logging.CRITICAL,
                )  # fmt: skip
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        _guard_pages(cluster.scheduler, dashboard=dashboard)
        client = None
        try:
            client = Client(cluster, set_as_default=False)
            yield client
        finally:
            _end(cluster, client)


@contextmanager
def _scratch_folder() -> Iterator[str]:
    """Yield a temporary folder, after the removal of those of killed sweeps."""
    _remove_abandoned()
    with tempfile.TemporaryDirectory(prefix=SCRATCH) as folder, Path(folder, "new").open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        Path(folder, "new").rename(Path(folder, OWNER))  # locked from the first moment under this name
        yield folder


def _remove_abandoned() -> None:
    """Remove the temporary folders of this user whose sweep has ended; the lock of a running one is held."""
    for folder in Path(tempfile.gettempdir()).glob(f"{SCRATCH}*"):
        with suppress(OSError):
            if folder.lstat().st_uid == os.getuid():
                with Path(folder, OWNER).open("r+b") as file:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(folder)


def _guard_pages(scheduler: Any, *, dashboard: bool) -> None:
    """Close the pages of the scheduler, or refuse requests with a host name that is not this machine's.

    A page of the internet whose name leads to the loopback address could otherwise read the dashboard.
    """
    if not dashboard:
        scheduler.http_server.stop()
        return
    from tornado.web import ErrorHandler

    pages = scheduler.http_application
    found = pages.find_handler

    def own_host(request: Any, **more: Any) -> Any:
        if request.host_name in (LOOPBACK, "localhost"):
            return found(request, **more)
        return pages.get_handler_delegate(request, ErrorHandler, {"status_code": 403})

    pages.find_handler = own_host


def _end(cluster: Any, client: Any) -> None:
    """End the worker processes at once, then close client and scheduler."""
    for nanny in list(cluster.workers.values()):
        with suppress(Exception):
            nanny.auto_restart = False
            os.kill(nanny.pid, signal.SIGKILL)
    for part in (client, cluster):
        if part is not None:
            with suppress(Exception):
                part.close(timeout=CLOSE_S)


@contextmanager
def _main_not_imported() -> Iterator[None]:
    """Hide the main module from new processes: a script without ``if __name__ == "__main__"`` would run in each."""
    main = sys.modules["__main__"]
    spec, file = getattr(main, "__spec__", None), getattr(main, "__file__", None)
    main.__spec__ = None
    if file is not None:
        del main.__file__
    try:
        yield
    finally:
        main.__spec__ = spec
        if file is not None:
            main.__file__ = file
