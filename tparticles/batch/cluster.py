"""The same jobs on a Dask cluster that runs already. Every machine sees the working and the output folder under the same paths.

A worker of the cluster renders each film in a process of its own, as `local` does. Where a worker dies, Dask hands its film to
another one, which goes on from what the first has finished; each time counts as a retry.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import secrets
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from ..errors import BackendError, InputError, RunError
from ..output.lock import holder
from .local import Child, Event, cores

_CONNECT = 10.0  # [s]
_LOOK = 0.5  # [s] between two looks whether a film is still wanted
_REFRESH = 5.0  # [s] between two counts of the workers
_AHEAD = 2  # films that wait at the scheduler, so that no worker waits for us
_END = 30.0  # [s] for stopped films to keep what is finished


class Cluster:
    """A pool of the workers that a Dask scheduler knows.

    address: `tcp://host:8786`. gpu: run on workers only that were started with `--resources GPU=1`, one film each.

    Raises InputError: dask is not installed, or the address is none; BackendError: nobody answers there.
    """

    threads: int | None = None  # each worker's own share

    def __init__(self, address: str, *, gpu: bool = False):
        try:
            from distributed import Client
        except ImportError:
            raise InputError("--dask needs Dask: pip install 'tparticles[cluster]'") from None
        if urlsplit(address).scheme not in ("tcp", "tls", "ws", "wss", "ucx") or not urlsplit(address).netloc:
            raise InputError(f"--dask {address}: an address such as tcp://scheduler:8786 is needed")
        _silence()
        try:
            self._client: Any = Client(address, timeout=_CONNECT, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            reason = " ".join(str(error).split())[:200]
            raise BackendError(f"no Dask scheduler answers at {address}: {reason}") from None
        self.address = address
        self._gpu = gpu
        self._topic = f"tparticles-{secrets.token_hex(8)}"
        self._told: queue.SimpleQueue[tuple[str, Event]] = queue.SimpleQueue()
        self._futures: dict[str, Any] = {}
        self._orders: dict[str, Event] = {}
        self._starts: Counter[str] = Counter()
        self._hosts: dict[str, int] = {}
        self._next_look = 0.0
        self._client.subscribe_topic(self._topic, lambda event: self._told.put((event[1].pop("job"), event[1])))

    def room(self) -> int:
        """Return how many films it takes now."""
        if time.monotonic() >= self._next_look:
            self._hosts = threads_by_host(self._client.nthreads())
            self._next_look = time.monotonic() + _REFRESH
        return sum(self._hosts.values()) + _AHEAD - len(self._futures)

    def submit(self, name: str, order: Event) -> None:
        """Hand a film to the scheduler. Its first event is "started", once for each worker that begins with it."""
        # Another worker may have had it before, and be dead.
        again = order["again"] or order["existing"] != "overwrite"
        self._orders[name] = order = {**order, "hosts": self._hosts, "again": again, "patience": _END}
        key = f"{self._topic}-{name}-{secrets.token_hex(4)}"
        options = {"resources": {"GPU": 1}} if self._gpu else {}
        future = self._client.submit(render, name, order, self._topic, key=key, pure=False, **options)
        self._futures[name], self._starts[name] = future, 0
        future.add_done_callback(lambda done: self._told.put((name, {"event": "end", "future": done})))

    def next(self, timeout: float) -> tuple[str, Event] | None:
        """Return the next event and its film, or None after `timeout` [s]. Raises RunError if the scheduler is gone."""
        if self._client.status != "running":
            raise RunError(
                f"the Dask scheduler {self.address} is gone; what is finished stays, `tparticles retry` goes on"
            )
        try:
            name, event = self._told.get(timeout=timeout)
        except queue.Empty:
            return None
        if name not in self._futures:
            return None
        if event["event"] == "started":
            self._starts[name] += 1
            if self._starts[name] > self._orders[name]["lives"]:
                self._futures.pop(name).cancel()
                return name, {
                    "event": "end",
                    "code": 1,
                    "error": f"lost {self._starts[name] - 1} workers of the cluster",
                }
        if "future" in event:
            if event["future"] is not self._futures[name]:
                return None  # of an attempt that was given up
            del self._futures[name]
            event = _end(event["future"])
        return name, event

    def stop(self, name: str) -> None:
        """Stop a film; what is finished of it is kept."""
        if future := self._futures.get(name):
            future.cancel()  # which is its end

    def close(self) -> list[tuple[str, Event]]:
        """Stop all films, wait until nobody writes into their folders, and leave the cluster."""
        with contextlib.suppress(Exception):  # the scheduler may be gone: its workers end their films themselves
            self._client.cancel(list(self._futures.values()))
            deadline = time.monotonic() + _END
            folders = [Path(self._orders[name]["out"]) for name in self._futures]
            while any(holder(folder) for folder in folders) and time.monotonic() < deadline:
                time.sleep(_LOOK)
        with contextlib.suppress(Exception):
            self._client.close(timeout=_CONNECT)
        return []


def _silence() -> None:
    """Keep Dask's log and its tracebacks off the terminal: what matters of them we say ourselves, in a line."""
    # Dask gives several of its loggers a level and a handler of their own.
    for name in list(logging.root.manager.loggerDict):
        if name.split(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def _end(future: Any) -> Event:
    """Return the last event of a film from what Dask says of it."""
    if future.status == "finished":
        with contextlib.suppress(Exception):  # the result may be lost with its worker
            return dict(future.result(timeout=_CONNECT))
    reason = "" if future.status != "error" else " ".join(str(future.exception()).split())[:300]
    return {"event": "end", "code": 1, "error": f"the cluster lost it ({reason or future.status})"}


def threads_by_host(workers: Mapping[str, int]) -> dict[str, int]:
    """Return how many films run at a time on each machine, of the threads of workers by address."""
    found: Counter[str] = Counter()
    for address, threads in workers.items():
        found[urlsplit(address).hostname or address] += threads
    return dict(found)


def render(name: str, order: Event, topic: str) -> Event:
    """Render a film in a process of its own, on a worker of the cluster; return its last event."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()
    films = order["hosts"].get(urlsplit(worker.address).hostname, worker.state.nthreads)
    order = {**order, "threads": max(1, cores() // max(1, films))}
    told: queue.SimpleQueue[tuple[str, Event]] = queue.SimpleQueue()
    out = Path(order["out"])
    if not Path(order["folder"]).is_dir():  # another worker may see it
        return {"event": "end", "code": 1, "error": f"{worker.address} does not see {order['folder']}"}
    child = Child(name, order, told, out.parents[1] / "logs" / f"{name}.log")
    worker.log_event(topic, {"job": name, "event": "started", "where": worker.address})
    while True:
        try:
            _, event = told.get(timeout=_LOOK)
        except queue.Empty:
            event = {}
        task = worker.state.tasks.get(key)
        if task is None or task.state != "executing":  # nobody waits for it any more
            child.stop()
        child.kill_late()
        if event.get("event") == "end":
            return event
        if event.get("event") == "ready":
            child.go()
        if event:
            worker.log_event(topic, {"job": name, **event})
