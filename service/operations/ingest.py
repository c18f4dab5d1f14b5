"""Windows in: gated, on disk, committed, and judged when their measurement is complete."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Any

from monitor_core.pipeline import AxisSettings, check_window
from monitor_core.preload import Calibration
from monitor_core.recording import Rejection, Window
from service.clock import now
from service.errors import ConflictError
from service.observability import Metrics
from service.operations.admission import Admission
from service.operations.judge import Judge
from service.operations.lanes import Lanes
from service.operations.settings_of_axis import AxisConfiguration, core_settings
from service.store import measurements
from service.store.axes import get_axis
from service.store.calibrations import CalibrationsInForce
from service.store.database import Database
from service.store.waveforms import WaveformFile, WaveformStore, content_sha256


class WindowStatus(StrEnum):
    """What became of a posted window."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    ALREADY_THERE = "already-there"


@dataclass(frozen=True, slots=True)
class WindowReceipt:
    """The answer to one posted window."""

    started_at: datetime
    measurement: str
    status: WindowStatus
    reason: str | None = None
    detail: str | None = None


@dataclass(frozen=True, slots=True)
class IngestReceipt:
    """The answer to one request."""

    windows: tuple[WindowReceipt, ...]
    measurements: tuple[dict[str, Any], ...]  # outcomes of the measurements judged


@dataclass(frozen=True, slots=True)
class _NewWindows:
    """Windows that are not stored yet, in time order, and what they are gated with."""

    windows: list[Window]
    hashes: list[str]
    settings: AxisSettings
    calibration: Calibration | None


class Ingest:
    """Takes windows of an axis, one request after another."""

    def __init__(
        self,
        database: Database,
        waveforms: WaveformStore,
        in_force: CalibrationsInForce,
        judge: Judge,
        lanes: Lanes,
        metrics: Metrics,
    ) -> None:
        self._database = database
        self._waveforms = waveforms
        self._in_force = in_force
        self._judge = judge
        self._lanes = lanes
        self._metrics = metrics

    def ingest(self, axis_id: str, windows: Sequence[Window], *, complete: bool) -> IngestReceipt:
        """Store windows durably and judge the measurements that they complete.

        Raises
        ------
        ConflictError
            If another window is stored (or posted) with the same start; then nothing of the request is stored.
        StorageError, BusyError
            If disk or database did not take it; then nothing of the request is stored, and it may be sent again.
        """
        hashes = [content_sha256(window) for window in windows]
        complete_names = {window.measurement for window in windows} if complete else set()
        with self._lanes.of(axis_id):
            new = self._new_windows(axis_id, windows, hashes)
            refusals, waiting = self._store(axis_id, new, complete_names)
            judged = self._judge.judge(axis_id, waiting, {window.started_at: window for window in new.windows})
        receipts = tuple(_receipts(windows, refusals))
        for receipt in receipts:
            self._metrics.windows.labels(receipt.reason or str(receipt.status)).inc()
        return IngestReceipt(receipts, tuple(judged))

    def finish_interrupted(self) -> None:
        """Judge what was stored but not judged when the service last stopped."""
        with self._database.read() as session:
            waiting = measurements.complete_measurements(session)
        for axis_id, measurement_ids in waiting.items():
            with self._lanes.of(axis_id):
                self._judge.judge(axis_id, measurement_ids, {})

    def _new_windows(self, axis_id: str, windows: Sequence[Window], hashes: Sequence[str]) -> _NewWindows:
        with self._database.read() as session:
            axis = get_axis(session, axis_id)
            calibration = self._in_force.of(session, axis)
            known = measurements.contents_at(session, axis_id, [window.started_at for window in windows])
        new = []
        for window, content in zip(windows, hashes, strict=True):
            if window.started_at not in known:
                known[window.started_at] = content
                new.append((window, content))
            elif known[window.started_at] != content:
                raise ConflictError(
                    f"axis '{axis_id}' has another window that started at {window.started_at.isoformat()}; "
                    "a window is never replaced, and nothing of this request was stored"
                )
        new.sort(key=lambda item: item[0].started_at)
        settings = core_settings(AxisConfiguration.model_validate(axis.configuration))
        return _NewWindows([window for window, _ in new], [content for _, content in new], settings, calibration)

    def _store(
        self, axis_id: str, new: _NewWindows, complete_names: set[str]
    ) -> tuple[dict[datetime, Rejection | None], list[int]]:
        """Write the waveforms, then the rows in one transaction.

        Returns
        -------
        dict of datetime to Rejection or None
            What came of each new window, by its start.
        list of int
            The measurements that are to be judged now.
        """
        received_at = now()
        file, gated = self._write_and_gate(axis_id, new, received_at) if new.windows else (None, [])
        committing = False
        try:
            with self._database.write() as session:
                admission = Admission(session, get_axis(session, axis_id, lock=True))
                refusals, rows = {}, []
                for index, (window, own_refusal) in enumerate(zip(new.windows, gated, strict=True)):
                    measurement_id, refusal = admission.admit(window, own_refusal)
                    refusals[window.started_at] = refusal
                    rows.append(
                        {
                            "axis_id": axis_id,
                            "measurement_id": measurement_id,
                            "started_at": window.started_at,
                            "received_at": received_at,
                            "content_sha256": new.hashes[index],
                            "index_in_file": index,
                            "refusal_reason": None if refusal is None else str(refusal.reason),
                            "refusal_detail": None if refusal is None else refusal.detail[:500],
                        }
                    )
                if file is not None:
                    measurements.add_windows(session, rows, file)
                waiting = admission.close(complete_names)
                session.flush()
                committing = True
        except BaseException:
            # A commit that failed may yet have happened (a lost connection): then the rows need their file.
            if file is not None and not committing:
                self._waveforms.delete(file)
            raise
        return refusals, waiting

    def _write_and_gate(
        self, axis_id: str, new: _NewWindows, received_at: datetime
    ) -> tuple[WaveformFile, list[Rejection | None]]:
        """Gate the windows while they are written; if that is not possible, no file stays."""
        writing = self._waveforms.begin_write(axis_id, new.windows, received_at)
        try:
            gated = [check_window(window, new.settings, new.calibration) for window in new.windows]
        except BaseException:
            self._waveforms.delete(writing.result())
            raise
        return writing.result(), [quality if isinstance(quality, Rejection) else None for quality in gated]


def _receipts(windows: Sequence[Window], refusals: Mapping[datetime, Rejection | None]) -> Iterator[WindowReceipt]:
    """Answer each posted window; one that stands twice in a request is already there the second time."""
    answered: set[datetime] = set()
    for window in windows:
        refusal = refusals.get(window.started_at)
        if window.started_at not in refusals or window.started_at in answered:
            yield WindowReceipt(window.started_at, window.measurement, WindowStatus.ALREADY_THERE)
        elif refusal is None:
            yield WindowReceipt(window.started_at, window.measurement, WindowStatus.ACCEPTED)
        else:
            yield WindowReceipt(
                window.started_at, window.measurement, WindowStatus.REFUSED, str(refusal.reason), refusal.detail
            )
        answered.add(window.started_at)
