"""Judge one stored measurement as another calibration would have: the way of a new one, with nothing stored."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

from pydantic import TypeAdapter

from monitor_core.pipeline import check_window
from monitor_core.preload import Calibration
from monitor_core.recording import Rejection, RejectionReason, Window
from service.clock import text_of
from service.documents.measurement import measurement_document, response_document
from service.errors import WaveformDamagedError
from service.json_types import JsonObject
from service.operations.monitoring.axis_configuration import AxisConfiguration, core_settings
from service.operations.monitoring.intake.admission import at_its_position
from service.operations.monitoring.intake.judge import Judged, judge, judged_point, stand
from service.store.intake import LONGEST_DETAIL, OPEN, MeasurementRecord
from service.store.rejudged import StagedRecord, StoredWindow
from service.store.trend.points import TrendPoint
from service.store.waveforms import WaveformStore

MEASUREMENT, POINT = TypeAdapter(MeasurementRecord), TypeAdapter(TrendPoint)
#: By the start of a window: for which reason it was refused before, for which now, and the detail of that.
_REFUSALS = TypeAdapter(dict[datetime, tuple[str | None, str | None, str | None]])
#: A window that says it began after it arrived says nothing of when it began, whatever the calibration.
_KEPT = str(RejectionReason.CLOCK_AHEAD)
#: Windows whose waveform is needed to judge a measurement: accepted ones, and those that stood elsewhere.
_AVERAGED = (None, str(RejectionReason.POSITION_MISMATCH))


@dataclass(frozen=True, slots=True)
class Anew:
    """What a history is judged by."""

    job_id: str
    axis_number: int
    configuration: AxisConfiguration
    calibration_id: int
    calibration: Calibration


def judged_anew(
    anew: Anew, row: MeasurementRecord, stored: Sequence[StoredWindow], waveforms: WaveformStore
) -> StagedRecord:
    """Return a measurement as it is judged now. Of one that is open only its windows are looked at."""
    if row.id is None:
        raise AssertionError(f"measurement '{row.name}' is stored")
    staged = StagedRecord(anew.job_id, row.id, row.revision)
    windows = _read(waveforms, stored)
    if windows is None:
        return staged
    settings = core_settings(anew.configuration)
    refusals: dict[datetime, Rejection | None] = {}
    for window in windows:
        quality = check_window(window, settings, anew.calibration)
        refusals[window.started_at] = quality if isinstance(quality, Rejection) else None
    passed = [window for window in windows if refusals[window.started_at] is None]
    refusals |= at_its_position(passed, anew.configuration.position_span_limit_mm)
    accepted = [window for window in passed if refusals[window.started_at] is None]
    now = replace(row)
    if row.status == OPEN:
        now.n_accepted = len(accepted)
        return replace(staged, measurement=_dumped(now), refusals=_changed(stored, refusals))
    outcome = judge(accepted, anew.configuration, anew.calibration)
    stand(Judged(now, outcome, None, accepted[0] if accepted else None, len(accepted)), anew.calibration_id)
    point = judged_point(anew.axis_number, now, outcome, 0, anew.calibration)
    return replace(
        staged,
        measurement=_dumped(now),
        point=POINT.dump_python(point, mode="json"),
        outcome=measurement_document(now, outcome),
        response=response_document(outcome),
        refusals=_changed(stored, refusals),
    )


def refusals_of(staged: StagedRecord) -> dict[datetime, tuple[str | None, Rejection | None]]:
    """Return the windows that are refused otherwise now, by their start: for which reason before, and why now."""
    return {
        start: (before, None if now is None else Rejection(RejectionReason(now), detail or ""))
        for start, (before, now, detail) in _REFUSALS.validate_python(staged.refusals or {}).items()
    }


def _read(waveforms: WaveformStore, stored: Sequence[StoredWindow]) -> list[Window] | None:
    """Return the windows that can be looked at, in time order; None if one is gone that the value rests on."""
    wanted = [window for window in stored if window.refusal_reason != _KEPT]
    try:
        return waveforms.read([window.place for window in wanted])
    except WaveformDamagedError:
        found: list[Window] = []
    for window in wanted:
        try:
            found += waveforms.read([window.place])
        except WaveformDamagedError:
            if window.refusal_reason in _AVERAGED:
                return None
    return found


def _dumped(row: MeasurementRecord) -> JsonObject:
    document: JsonObject = MEASUREMENT.dump_python(row, mode="json")
    return document


def _changed(stored: Sequence[StoredWindow], refusals: dict[datetime, Rejection | None]) -> JsonObject:
    changed: JsonObject = {}
    for window in stored:
        if window.started_at not in refusals:
            continue
        refusal = refusals[window.started_at]
        reason, detail = (None, None) if refusal is None else (str(refusal.reason), refusal.detail[:LONGEST_DETAIL])
        if (reason, detail) != (window.refusal_reason, window.refusal_detail):
            changed[text_of(window.started_at)] = [window.refusal_reason, reason, detail]
    return changed
