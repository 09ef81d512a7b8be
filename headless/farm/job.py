"""Parts handed out to a Dask scheduler's workers, watched, and taken back."""

from __future__ import annotations

import importlib.util
import math
import os
import statistics
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from time import monotonic, time

import dask
from distributed import Client, Future, KilledWorker, LocalCluster
from distributed.comm import CommClosedError

from ...core.errors import SceneError
from ...core.threads import Cancelled, thread_count
from .parts import Part, Segments
from .worker import FarmError, FarmNanny, do_part, versions

CONNECT = 15  # s
AWAITED = 60  # s in which another worker comes where all are lost
FETCHED = 120  # s in which a part's files come from its worker
LOOK = 1.0  # s between two looks at what is going on
AHEAD = 2  # parts of a segment that a worker has: the one that it does, and the next one, for which it need not wait until we ask
TRIES = 20  # of a part whose worker is lost
# Of workers on this machine, whose cores are there to render: each of Dask's processes would look after itself with 3 to 5 % of a core.
CALM = {"distributed.admin.tick.interval": "500 ms", "distributed.worker.profile.enabled": False}
GONE = "the scheduler has gone; start it again, and the job with --skip-existing"
SLOW = 3.0  # times the usual time of a part, after which an idle worker tries it, too


class _Client(Client):
    """One that has ended where it could not start.

    The end stops a thread under a lock of Dask's.  Were it to come by chance, by the garbage collector while Dask holds that lock to start another, both
    would wait for ever.
    """

    def start(self, **kwargs) -> None:
        """As Dask's."""
        try:
            super().start(**kwargs)
        except BaseException:
            self.close()
            raise


@contextmanager
def connected(scheduler: str | None, workers: int | None) -> Iterator[Client]:
    """A client of a scheduler, or of as many workers on this machine; SceneError where there is none to be reached, or nobody to work."""
    with ExitStack() as stack:
        # A part that outlives many workers is no fault of its own: how often it is tried, the job says.
        stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": TRIES}))
        if scheduler is None:
            stack.enter_context(dask.config.set(CALM))
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="lumigate-farm-", ignore_cleanup_errors=True))
            cluster = LocalCluster(
                n_workers=workers or 1, threads_per_worker=1, processes=True, worker_class=FarmNanny, local_directory=folder,
                dashboard_address=":0", silence_logs=50,
            )  # fmt: skip
            stack.enter_context(cluster)
        try:
            client = stack.enter_context(_Client(scheduler or cluster, timeout=CONNECT))
        except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:  # the last two: certificates are missing
            refused = str(error) or type(error).__name__
            raise SceneError(
                f"no scheduler answers at {scheduler!r} ({refused}); start one with `dask scheduler`, or use --workers"
            ) from error
        try:
            client.wait_for_workers(1, timeout=CONNECT)
        except TimeoutError as error:
            raise SceneError(
                f"no worker has come to the scheduler at {scheduler!r}; start some with `dask worker` (docs/farm.md)"
            ) from error
        yield client


def local_threads(workers: int | None) -> int:
    """Threads for each of so many workers of this machine."""
    return max(1, thread_count() // (workers or 1))


@dataclass
class _Running:
    """A part that is not done; worker: who was asked to do it, where that matters; seen: when it was first seen to be a worker's next."""

    part: Part
    worker: str | None = None
    futures: list[Future] = field(default_factory=list)
    tries: int = 1
    copied: bool = False
    seen: float = math.inf


class Job:
    """Parts under way; `results` gives them back as they are done.

    scene: content of the scene's file, sent once to each worker that needs it.
    """

    def __init__(self, client: Client, parts: Sequence[Part], scene: bytes | None = None):
        self._client = client
        self._expected = versions()
        self._content, self._scene = scene, None
        self._send()
        self._done: SimpleQueue[tuple[str, Future]] = SimpleQueue()
        self._took: list[float] = []
        # The job that began first goes first, though it submits later: two jobs must not take turns with a worker's Blender.
        self._priority = -time()
        self._running = {part.key: _Running(part) for part in parts}
        self._slow: set[str] = set()  # workers
        self._proved: set[str] = set()  # workers that have done a part
        rows: dict[int, list[Part]] = {}
        for part in parts:
            if part.segment is None:
                self._submit(self._running[part.key], part.key)
            else:
                rows.setdefault(part.segment, []).append(part)
        self._segments = Segments(rows.values())
        self._hand_out()

    def _send(self) -> None:
        """Give the scene's content to a worker, from which the others have it, if none has: the last that had it may be lost."""
        held = self._scene is not None and self._scene.status == "finished" and self._client.who_has([self._scene])[self._scene.key]
        if self._content is not None and not held:
            # A key of its own each time: what is known of a lost one does not stand in its way.
            self._scene = self._client.scatter(self._content, hash=False)

    def _submit(self, running: _Running, key: str, **options) -> None:
        # Without the time in which Dask holds all that comes for one, a worker does its parts in the order in which it gets them.
        options |= {"priority": self._priority, "fifo_timeout": 0}
        future = self._client.submit(do_part, running.part, self._expected, self._scene, key=key, pure=False, **options)
        running.futures.append(future)
        future.add_done_callback(lambda done, name=running.part.key: self._done.put((name, done)))

    def _hand_out(self) -> None:
        """Give the workers what they do next of the segments.

        It is theirs until they are lost; then Dask has it done by any other.
        """
        if not self._segments:
            return
        workers = self._workers()
        if self._scene is not None and self._scene.status != "finished":
            self._send()
        # One that is slow gets nothing as long as there are others.
        workers = [worker for worker in workers if worker not in self._slow] or workers
        self._segments.keep(workers)
        busy = Counter(running.worker for running in self._running.values() if any(not future.done() for future in running.futures))
        # Towards the end, what a worker has not begun is better left for those that have nothing to do.  And one to which the scene has
        # yet to be sent begins with any of the parts that wait for it.
        ahead = AHEAD if len(self._segments) > len(workers) else 1
        for count in range(ahead):
            for worker in workers:
                if busy[worker] > count or (count and worker not in self._proved):
                    continue
                part = self._segments.take(worker)
                if part is None:
                    continue
                busy[worker] += 1
                running = self._running[part.key] = self._running.pop(part.key)  # in the order in which they are handed out
                running.worker = worker
                self._submit(running, part.key, workers=[worker], allow_other_workers=True)

    def _workers(self) -> list[str]:
        """Addresses of all workers (of which `Client.scheduler_info` leaves out all but five, in some versions of Dask)."""
        if self._client.status != "running":
            raise SceneError(GONE)
        try:
            return list(self._client.nthreads())
        except OSError as error:
            raise SceneError(GONE) from error

    def results(self, tell: Callable[[str], None]) -> Iterator[tuple[Part, dict]]:
        """(part, what `do_part` gives) as they come; tell: takes lines about workers that are lost or slow.

        Raises SceneError where a part cannot be done, or the scheduler has gone.
        """
        try:
            while self._running:
                try:
                    key, done = self._done.get(timeout=LOOK)
                except Empty:
                    self._look_around(tell)
                    continue
                running = self._running.get(key)
                if running is None or done not in running.futures:  # the slower one of two copies
                    continue
                self._proved.add(running.worker)
                self._hand_out()  # nobody waits while a result is fetched
                result = self._result(running, done, tell)
                if result is None:
                    continue
                del self._running[key]
                others = [future for future in running.futures if future is not done]
                if others:
                    self._client.cancel(others, force=True)
                if done.key == running.part.key:  # not a copy
                    self._slow.discard(running.worker)
                self._took.append(result["seconds"])
                yield running.part, result
        finally:
            self.cancel()

    def _result(self, running: _Running, done: Future, tell: Callable[[str], None]) -> dict | None:
        """What a part gave; None where it is tried again."""
        try:
            return done.result(timeout=FETCHED)
        except FarmError as error:
            raise SceneError(str(error)) from error
        except (KilledWorker, ConnectionError, CommClosedError, CancelledError, TimeoutError) as error:
            if self._client.status != "running":
                raise SceneError(GONE) from error
            running.tries += 1
            if running.tries > TRIES:
                raise SceneError(f"{running.part.key} has lost {TRIES} workers; try it alone, with fewer threads or less memory") from error
            tell(f"{running.part.key}: its worker was lost ({type(error).__name__}); it is tried again")
            running.futures.remove(done)
            running.seen, running.worker = math.inf, None
            self._await_worker(tell)
            self._send()
            self._submit(running, f"{running.part.key}-try-{running.tries}")
            return None

    def _await_worker(self, tell: Callable[[str], None]) -> None:
        """Go on as soon as there is a worker; SceneError where none comes."""
        if self._workers():
            return
        tell("all workers are lost; waiting for another one")
        try:
            self._client.wait_for_workers(1, timeout=AWAITED)
        except TimeoutError as error:
            raise SceneError(f"all workers are lost, and none came in {AWAITED} s; start some, and the job with --skip-existing") from error

    def _look_around(self, tell: Callable[[str], None]) -> None:
        """Whether the scheduler is there; a part that takes far longer than others goes to a worker that has nothing to do, too."""
        self._await_worker(tell)
        self._hand_out()
        if len(self._took) < 2:
            return
        now, processing = monotonic(), self._client.processing()
        begun = {str(key) for keys in processing.values() for key in keys}
        waited_for: set[str] = set()  # workers
        for running in self._running.values():
            if any(future.key in begun for future in running.futures) and running.worker not in waited_for:
                running.seen = min(running.seen, now)
            if running.worker is not None and running.futures:
                waited_for.add(running.worker)
        usual = max(statistics.median(self._took), LOOK)
        slow = [running for running in self._running.values() if not running.copied and now - running.seen > SLOW * usual]
        idle = [worker for worker, keys in processing.items() if not keys]
        for running, worker in zip(slow, idle):
            tell(f"{running.part.key} is slow: another worker tries it, too")
            running.copied = True
            if running.worker is not None:
                self._slow.add(running.worker)
            self._submit(running, f"{running.part.key}-copy", workers=[worker], allow_other_workers=False)

    def cancel(self) -> None:
        """Stop what is still under way."""
        futures = [future for running in self._running.values() for future in running.futures]
        if futures and self._client.status == "running":
            self._client.cancel(futures, force=True)
        self._running.clear()


def run_job(
    client: Client, parts: Sequence[Part], scene: bytes | None, progress, tell: Callable[[str], None]
) -> Iterator[tuple[Part, dict]]:
    """`Job.results` with a progress bar; raises Cancelled where the progress function says so."""
    whole, done = sum(part.weight for part in parts), 0.0
    job = Job(client, parts, scene)
    for part, result in job.results(tell):
        done += part.weight
        if not progress(f"{len(parts)} parts on {len(client.nthreads())} workers", done / whole):
            job.cancel()
            raise Cancelled
        yield part, result


def dashboard(client: Client) -> str | None:
    """The address of the scheduler's dashboard; None where this machine has not the package bokeh, which shows it."""
    return client.dashboard_link if importlib.util.find_spec("bokeh") else None


def job_name() -> str:
    """A prefix of keys that no other job has."""
    return f"lumigate-{os.getpid()}-{os.urandom(3).hex()}"
