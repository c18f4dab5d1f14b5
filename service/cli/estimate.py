"""``preload estimate DATA --calibration FILE``: newtons with a 95 % interval per row or measurement."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import click

from monitor_core.modal import excitation_remark
from monitor_core.preload import Calibration, PreloadEstimate, SessionPreload, estimate_preload
from monitor_core.recording import Rejection
from monitor_core.recordings.calibration_file import read_calibration
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.recordings.modal_csv import read_modal_table
from monitor_core.session import (
    SessionMeasurement,
    excitation_remarks,
    judge_session,
    preload_of_session,
    sessions_of,
    with_session_doubts,
)
from monitor_core.uncertainty import Interval
from service.cli.inputs.data import (
    Data,
    DataKind,
    axis_settings,
    calibration_at,
    data_argument,
    data_of,
    map_option,
    opened_session,
)
from service.cli.options import json_option
from service.cli.output import print_json, print_table
from service.documents.measurement import (
    ends_in_newtons,
    estimate_document,
    friction_document,
    if_stated_in_words,
    refusal_document,
    session_document,
)
from service.json_types import JsonObject


@click.command()
@data_argument
@map_option
@click.option(
    "--calibration", "calibration_file", required=True, type=click.Path(path_type=Path), help="From preload calibrate."
)
@json_option
def estimate(paths: tuple[Path, ...], map_path: Path | None, calibration_file: Path, as_json: bool) -> None:
    """Turn natural frequencies or a recorded session into preload."""
    data = data_of(paths, map_path, takes=(DataKind.MODAL_TABLE, DataKind.SESSION))
    calibration = read_calibration(calibration_at(calibration_file))
    estimates, sessions = _of_session(data, calibration) if data.is_session else (_of_table(data.file, calibration), [])
    regions = _regions(estimates)
    if as_json:
        joined: list[JsonObject] = [
            {"measurements": list(session.measurements)} | session_document(session.joint) for session in sessions
        ]
        documents: list[JsonObject] = [_region_document(region) for region in regions]
        print_json({"estimates": [_document(item) for item in estimates], "sessions": joined, "regions": documents})
        return
    print_table(
        f"Preload from {data.name}",
        ("measurement", "position", "frequency", "preload", "95 % coverage", "mostly from", "remarks"),
        [_row(item) for item in estimates],
    )
    if sessions:
        print_table(
            "The one preload of a session, by all its measurements",
            ("measurements", "places", "preload", "95 % coverage", "mostly from", "remarks"),
            [_joint_row(session) for session in sessions],
        )
    if regions:
        print_table(
            "The mean of repeated readings of one stated preload, and where it is with 95 % confidence",
            ("stated", "position", "readings", "mean", "from", "to", "other levels"),
            [_region_row(region) for region in regions],
        )


@dataclass(frozen=True, slots=True)
class _Estimated:
    """What became of a row or a measurement."""

    measurement: str
    position_mm: float
    stated_preload: float | None  # [N]
    frequency_hz: float | None
    answer: PreloadEstimate | Rejection
    warnings: tuple[str, ...] = ()  # of the measurement of its mode
    refused_windows: Mapping[str, int] = field(default_factory=dict)  # by reason
    friction: JsonObject = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Region:
    """Readings at one position of what is stated as one preload, Fig. 8 of Nguyen et al. (2018)."""

    stated_preload: float  # [N]
    position_mm: float
    n_readings: int
    mean: Interval  # [N]
    apart: bool | None  # from every other level at this position; None: there is none


@dataclass(frozen=True, slots=True)
class _Joined:
    """A session and the one preload that its measurements give together."""

    measurements: tuple[str, ...]
    joint: SessionPreload


def _of_session(data: Data, calibration: Calibration) -> tuple[list[_Estimated], list[_Joined]]:
    estimates, sessions = [], []
    with opened_session(data) as session:
        judged = list(judge_session(session, axis_settings(None), calibration))
        remarks = excitation_remarks(judged)
        judged = with_session_doubts(judged, calibration)
        for together in sessions_of(judged):
            if (joint := preload_of_session(together, calibration)) is not None:
                names = [m.name for m in together if isinstance(m.outcome.preload, PreloadEstimate)]
                sessions.append(_Joined(tuple(names), joint))
        for item in judged:
            modal = item.outcome.modal
            frequency = None if isinstance(modal, Rejection) else modal.mode.frequency.value
            position_mm = to_millimetres(item.conditions.position)
            driven = remarks.get(item.name) or _against_calibration(item, calibration)
            warnings = () if isinstance(modal, Rejection) else (*modal.warnings, *([] if driven is None else [driven]))
            refused = Counter(str(rejection.reason) for rejection in item.refused_windows)
            if not isinstance(modal, Rejection):
                refused.update(str(rejection.reason) for _, rejection in modal.refused_windows)
            friction, preload = friction_document(item.outcome.friction), item.outcome.preload
            stated = item.conditions.preload
            if preload is None:
                raise AssertionError("by a calibration there is a preload, or a refusal")
            estimates.append(
                _Estimated(item.name, position_mm, stated, frequency, preload, warnings, refused, friction)
            )
    return estimates, sessions


def _against_calibration(item: SessionMeasurement, calibration: Calibration) -> str | None:
    """Return what is said of an excitation that is not the calibration's, where no doubt of the preload says it."""
    modal, preload, level = item.outcome.modal, item.outcome.preload, calibration.excitation_level
    doubted = isinstance(preload, PreloadEstimate) and "excitation-level" in preload.deviations
    alike = not isinstance(modal, Rejection) and modal.excitation_quantity is calibration.excitation_quantity
    if doubted or not alike or isinstance(modal, Rejection) or not level:
        return None
    return excitation_remark(modal, level, "the calibration")


def _of_table(path: Path, calibration: Calibration) -> list[_Estimated]:
    estimates = []
    for number, row in enumerate(read_modal_table(path), start=1):
        reading = row.reading
        answer = estimate_preload(reading.estimate, reading.conditions, calibration)
        estimates.append(_Estimated(f"row {number}", to_millimetres(row.position), row.preload, row.frequency, answer))
    return estimates


def _regions(estimates: list[_Estimated]) -> list[_Region]:
    """Return the interval of the mean, Eq. (10) of Nguyen et al. (2018), of each stated level at each position."""
    readings: dict[tuple[float, float], list[float]] = {}
    for item in estimates:
        if item.stated_preload is not None and isinstance(item.answer, PreloadEstimate):
            readings.setdefault((item.stated_preload, item.position_mm), []).append(item.answer.preload)
    if all(len(some) < 2 for some in readings.values()):
        return []
    from monitor_core.trend import confidence_interval_of_mean  # noqa: PLC0415  # what is estimated seldom repeats

    means = {at: confidence_interval_of_mean(some) for at, some in sorted(readings.items()) if len(some) > 1}
    return [
        _Region(level, x, len(readings[level, x]), mean, _is_apart(mean, [
            other for (another, elsewhere), other in means.items() if another != level and elsewhere == x
        ]))
        for (level, x), mean in means.items()
    ]  # fmt: skip


def _is_apart(mean: Interval, others: Sequence[Interval]) -> bool | None:
    """Return whether an interval meets none of the others; None where there is none to meet."""
    return all(mean.lower > other.upper or other.lower > mean.upper for other in others) if others else None


def _region_document(region: _Region) -> JsonObject:
    return {
        "stated_preload_n": region.stated_preload,
        "position_mm": region.position_mm,
        "n_readings": region.n_readings,
        "mean_interval_95_n": [region.mean.lower, region.mean.upper],
        "apart_from_other_levels": region.apart,
    }


def _region_row(region: _Region) -> tuple[str, ...]:
    low, high = region.mean.lower, region.mean.upper
    mean = f"{0.5 * (low + high):.1f} N"
    apart = {None: "—", True: "apart", False: "overlap"}[region.apart]
    place = (f"{region.stated_preload:g} N", f"{region.position_mm:.1f} mm", str(region.n_readings))
    return (*place, mean, f"{low:.1f} N", f"{high:.1f} N", apart)


def _document(item: _Estimated) -> JsonObject:
    place: JsonObject = {
        "measurement": item.measurement,
        "position_mm": item.position_mm,
        "frequency_hz": item.frequency_hz,
    }
    place |= item.friction
    place["warnings"] = _said(item)
    place["windows_refused"] = dict(item.refused_windows)
    if isinstance(item.answer, Rejection):
        return place | {"preload_n": None, "interval_95_n": None, "extrapolated": None} | refusal_document(item.answer)
    return place | estimate_document(item.answer) | {"refused": False}


def _said(item: _Estimated) -> list[str]:
    """Return all that is said of a measurement: doubts first, then what it rests on."""
    windows = [f"{count} windows refused: {reason}" for reason, count in item.refused_windows.items()]
    if isinstance(item.answer, Rejection):
        return [*item.warnings, *windows]
    answer = item.answer
    return [
        *(f"in doubt: {doubt.detail}" for doubt in answer.doubts),
        *(f"{name} outside the calibrated range" for name in answer.outside),
        *answer.assumptions,
        *filter(None, [_brought(answer)]),
        *item.warnings,
        *windows,
    ]


def _brought(answer: PreloadEstimate | SessionPreload) -> str:
    better = ((each.quantities, ends_in_newtons(each.interval)) for each in answer.if_stated)
    return if_stated_in_words(ends_in_newtons(answer.interval), better)


def _row(item: _Estimated) -> tuple[str, ...]:
    answer = item.answer
    frequency = "—" if item.frequency_hz is None else f"{item.frequency_hz:.3f} Hz"
    place = (item.measurement, f"{item.position_mm:.1f} mm", frequency)
    if isinstance(answer, Rejection):
        return (*place, "—", "—", "—", "; ".join([f"{answer.reason}: {answer.detail}", *_said(item)]))
    return (*place, *_in_newtons(answer), "; ".join(_said(item)))


def _joint_row(session: _Joined) -> tuple[str, ...]:
    joint, measurements = session.joint, session.measurements
    nearest, farthest = min(joint.positions), max(joint.positions)
    places = f"{to_millimetres(nearest):.1f} to {to_millimetres(farthest):.1f} mm"
    names = f"{measurements[0]} to {measurements[-1]} ({len(measurements)})"
    return (names, places, *_in_newtons(joint), _brought(joint))


def _in_newtons(answer: PreloadEstimate | SessionPreload) -> tuple[str, str, str]:
    low, high = answer.interval.lower, answer.interval.upper
    upper = f"{high:.0f}" if math.isfinite(high) else "∞"
    made_of = ", ".join(f"{name.replace('_', ' ')} {100 * share:.0f} %" for name, share in _largest(answer))
    return f"{answer.preload:.0f} N", f"{low:.0f} to {upper} N", made_of


def _largest(estimate: PreloadEstimate | SessionPreload) -> list[tuple[str, float]]:
    """Return the two largest shares of the variance; the document has all."""
    return sorted(asdict(estimate.shares).items(), key=lambda share: -share[1])[:2]
