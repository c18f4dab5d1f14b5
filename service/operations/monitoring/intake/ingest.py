"""Windows in: gated, judged when they complete a measurement, on disk and committed, then acknowledged.

One thread takes all requests that wait, computes for each axis, and commits for all of them at once: a commit waits for
the disk, and to wait once for many costs as much as to wait for one.
"""

import asyncio
import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from typing import TypeVar

from monitor_core.recording import Window
from service.clock import now
from service.errors import BusyError, StorageError, tell_failure
from service.observability import Metrics
from service.operations.monitoring.intake.batch import Batch, IngestReceipt, KnownAxes, Post, by_axis
from service.operations.monitoring.intake.judge import Settled
from service.store import intake
from service.store.database import Database, writing
from service.store.waveforms import WaveformStore

log = logging.getLogger(__name__)

Read = TypeVar("Read")

#: So many requests are taken at once: the first of them waits for the computation of all.
MOST_AT_ONCE = 32
#: How often measurements are looked for that no window comes to any more.
CLOSED_EVERY_S = 5.0


class Ingest:
    """Takes windows of the axes.

    What came from one request or several, in which order, from whom and through which service, makes no difference to
    what is stored: at an axis one service works at a time.
    """

    def __init__(
        self,
        database: Database,
        waveforms: WaveformStore,
        metrics: Metrics,
        follow_alarm: Callable[[str], None],
    ) -> None:
        self._database = database
        self._waveforms = waveforms
        self._follow_alarm = follow_alarm  # told the axis that a measurement left in alarm
        self._known = KnownAxes()
        self._metrics = metrics
        self._waiting: queue.SimpleQueue[Post | None] = queue.SimpleQueue()
        self._passed_over: list[Post] = []  # in the last round, because another service was at work at their axis
        self._readers = ThreadPoolExecutor(max_workers=1, thread_name_prefix="bodies")
        self._thread = threading.Thread(target=self._serve, name="ingest", daemon=True)
        self._thread.start()

    def read_by(self, reading: Callable[[], Read]) -> asyncio.Future[Read]:
        """Read what was sent in the thread that does this for all senders, one body at a time."""
        return asyncio.get_running_loop().run_in_executor(self._readers, reading)

    def submit(self, axis_id: str, windows: Sequence[Window], *, complete: bool) -> Future[IngestReceipt]:
        """Store windows durably and judge the measurements that they complete, as soon as it is their turn.

        The future raises UnknownResourceError if there is no such axis; ConflictError if another window is stored (or
        posted) with the same start; StorageError or BusyError if disk or database did not take it: it may be sent
        again. Whatever is raised, nothing of the request is stored.
        """
        post = Post(axis_id, windows, complete)
        self._waiting.put(post)
        return post.answer

    def ingest(self, axis_id: str, windows: Sequence[Window], *, complete: bool) -> IngestReceipt:
        """Do the same, and wait for it."""
        return self.submit(axis_id, windows, complete=complete).result()

    @property
    def n_waiting(self) -> int:
        """How many requests wait for their turn at this moment."""
        return self._waiting.qsize() + len(self._passed_over)

    def close(self) -> None:
        """Finish what waits, and take no more."""
        self._readers.shutdown()
        self._waiting.put(None)
        self._thread.join()

    def close_overdue(self) -> None:
        """Judge measurements that no window came to for longer than their axis waits, with the windows they have."""
        with self._database.reading() as connection:
            overdue = intake.overdue(connection, now())
        for axis_id, number in overdue:
            self._round([Post(axis_id, (), overdue=frozenset({number}))], wait=True)

    def _serve(self) -> None:
        stopped, due = False, 0.0
        while not stopped or self._passed_over:
            wait = bool(self._passed_over)
            posts, end = self._next()
            stopped = stopped or end
            try:
                if posts:
                    self._passed_over = self._round(posts, wait=wait)
                if time.monotonic() >= due:
                    due = time.monotonic() + CLOSED_EVERY_S
                    self.close_overdue()
            except Exception as error:  # noqa: BLE001 - the edge of this thread, which must live on
                tell_failure(log, "windows were not taken", error)
                _refuse(posts, error)
                self._passed_over = []

    def _next(self) -> tuple[list[Post], bool]:
        """Wait for requests and return those that wait, and whether no more will come."""
        posts, self._passed_over = self._passed_over, []
        try:
            posts_or_end = self._waiting.get(timeout=0.0 if posts else CLOSED_EVERY_S)
            while posts_or_end is not None:
                posts.append(posts_or_end)
                if len(posts) >= MOST_AT_ONCE:
                    return posts, False
                posts_or_end = self._waiting.get_nowait()
        except queue.Empty:
            return posts, False
        return posts, True

    def _round(self, posts: Sequence[Post], *, wait: bool) -> list[Post]:
        """Take requests to several axes; where they cannot be stored together, each axis is tried by itself.

        Returns those that were passed over, because another service is at work at their axis; never the first where
        ``wait`` says so, nor one that is alone.
        """
        axes = by_axis(posts)
        try:
            return self._store(axes, wait=wait)
        except Exception as error:  # noqa: BLE001 - whatever it is, whoever waits is told
            if len(axes) == 1:
                _refuse(posts, error)
                return []
        for axis_posts in axes.values():
            self._round([post for post in axis_posts if not post.answer.done()], wait=True)
        return []

    def _store(self, axes: Mapping[str, list[Post]], *, wait: bool) -> list[Post]:
        with ExitStack() as files:
            connection = files.enter_context(self._database.connect())
            free = files.enter_context(self._database.at_axes(connection, list(axes), wait=wait))
            batches = []
            for axis_id in free:
                try:
                    with self._database.translated():
                        batch = Batch(connection, axis_id, axes[axis_id], self._known)
                        batch.compute(connection, self._waveforms, files, self._metrics)
                    batches.append(batch)
                except Exception as error:  # what is wrong with one axis is not that of the others
                    if connection.in_transaction() and len(free) > 1 and isinstance(error, StorageError | BusyError):
                        raise  # of the transaction that all share
                    _refuse(axes[axis_id], error)
            full = [batch for batch in batches if not batch.empty]
            places = [batch.sync() for batch in full]
            settled: dict[str, Settled | None] = {}
            if full:
                with writing(connection):
                    for batch, lying in zip(full, places, strict=True):
                        settled[batch.axis.id] = batch.store(connection, lying)
        for batch in batches:
            self._answer(batch, settled.get(batch.axis.id))
        return [post for axis_id, posts in axes.items() if axis_id not in free for post in posts]

    def _answer(self, batch: Batch, settled: Settled | None) -> None:
        receipts = [batch.receipt(post, settled) for post in batch.posts]
        for receipt in receipts:
            for window in receipt.windows:
                self._metrics.windows.labels(window.reason or str(window.status)).inc()
        if settled is not None:
            self._note(batch, settled)
        for post, receipt in zip(batch.posts, receipts, strict=True):
            post.answer.set_result(receipt)

    def _note(self, batch: Batch, settled: Settled) -> None:
        """Count what was judged, and have an alarm that it left the axis in explained."""
        for outcome in settled.outcomes:
            self._metrics.measurements.labels(outcome).inc()
        for reason in settled.uncharted:
            self._metrics.uncharted.labels(reason).inc()
        for kind in settled.new_alarms:
            self._metrics.alarms.labels(kind).inc()
        if settled.measurements and settled.alarmed and batch.configuration.drive_model is not None:
            self._follow_alarm(batch.axis.id)


def _refuse(posts: Sequence[Post], error: Exception) -> None:
    for post in posts:
        if not post.answer.done():
            post.answer.set_exception(error)
