"""``/axes/{axis}/measurements/{measurement}``: why this value, with pictures of the response and of the windows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Final

import numpy as np
from fastapi import APIRouter, Query, Response

from monitor_core.arrays import FloatArray
from monitor_core.modal import GateReading
from monitor_core.preload import PreloadLadder
from monitor_core.recording import ExcitationQuantity, ResponseQuantity, Window
from monitor_core.response import FrequencyResponse
from service.api.access import needs
from service.api.services import Services, ServicesOf
from service.api.trend import judgement_out
from service.documents.said import N_
from service.documents.stored_measurement import NOTHING_MEASURED, StoredMeasurement
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId, RowId
from service.operations.monitoring.evidence import Responses, evidence_of
from service.operations.monitoring.trend import MeasurementView
from service.report.line_chart import LOW_NARROW, LOW_WIDE, NARROW, WIDE, Curve, LinePicture, line_chart
from service.report.svg import Frame
from service.store.trend.points import Span
from service.web.site import PageOf
from service.web.trend_view import MOST_SHOWN, Charts, twice
from service.web.words import Words

router = APIRouter(include_in_schema=False)

#: What a gate asks, by the reason for which it refuses.
GATES: Final = {
    "no-peak-in-band": N_("the mode lies where it is expected"),
    "low-coherence": N_("coherence around the mode"),
    "too-few-averages": N_("windows that were averaged"),
    "wrong-phase": N_("phase of the mode, from the calibrated one"),
    "uncertain-frequency": N_("uncertainty of the frequency"),
    "ambiguous-modes": N_("height of a second mode over that of the first"),
}


@dataclass(frozen=True, slots=True)
class GateLine:
    """A gate as a line of the table; limits that are open are None."""

    words: str
    unit: str
    value: float | None
    lower: float | None
    upper: float | None
    passed: bool


@dataclass(frozen=True, slots=True)
class Rung:
    """A step of the ladder: what it takes off 1/f², and with which share of the variance."""

    words: str
    formula: str
    value: float
    share: float | None


@router.get("/axes/{axis}/measurements/{measurement}", dependencies=[needs(Scope.TRENDS_READ)])
def measurement_page(
    axis: AxisId,
    measurement: RowId,
    page: PageOf,
    on: ServicesOf,
    other: Annotated[int | None, Query(alias="with", ge=1, lt=2**63)] = None,
) -> Response:
    """Show why a measurement has its value; its response over the baseline's, or over that of another measurement."""
    view = on.trend.measurement(axis, measurement)
    beside = None if other is None else on.trend.measurement(axis, other)  # of this axis, or refused
    measured = view.outcome or NOTHING_MEASURED
    evidence = evidence_of(on.database, on.waveforms, axis, view)
    responses, ladder = evidence.responses(other), evidence.ladder()
    before, following = evidence.neighbours()
    newest = on.trend.page(axis, Span(), cursor=None, limit=MOST_SHOWN + 1, newest_first=True)
    return page.show(
        "measurement.html",
        axis=on.axes.get(axis),
        row=view.row,
        measured=measured,
        gates=_gates(evidence.gates(), measured),
        advice=_advice(on, measured),
        ladder=ladder,
        rungs=[] if ladder is None else _rungs(ladder, measured.variance_shares),
        pictures=response_pictures(page.words, responses, measured.frequency_hz),
        beside=beside,
        others=[point for point in newest.points if point.measurement_id != measurement],
        windows=_windows(view),
        drawn=window_pictures(page.words, responses.windows),
        let_go=view.let_go,
        judgements=[judgement_out(judgement) for judgement in evidence.judgements()],
        before=before,
        following=following,
    )


def _gates(readings: tuple[GateReading, ...], measured: StoredMeasurement) -> list[GateLine]:
    """Return the gates, and the one that refused if none of these did."""
    lines = [
        GateLine(GATES[str(read.gate)], read.unit, read.value, read.lower, read.upper, read.passed) for read in readings
    ]
    if measured.refused and measured.reason is not None and all(line.passed for line in lines):
        lines.append(GateLine(measured.reason, "", None, None, None, passed=False))
    return lines


def _advice(on: Services, measured: StoredMeasurement) -> list[object]:
    """Return what is known of a refusal, and of each doubt."""
    asked = [on.advice.of("refusal", measured.reason)] if measured.refused and measured.reason else []
    asked += [on.advice.of("doubt", doubt.reason) for doubt in measured.doubts]
    return [advice for advice in asked if advice is not None]


def _rungs(ladder: PreloadLadder, shares: dict[str, float]) -> list[Rung]:
    def share(*names: str) -> float | None:
        stated = [shares[name] for name in names if name in shares]
        return sum(stated) if stated else None

    return [
        Rung(N_("frequency, and its scatter"), "1/f²", ladder.inverse_square, share("frequency", "reproducibility")),
        Rung(N_("payload"), "− µ·Δm/(1 + µ·Δm)·1/f²", -ladder.payload, share("payload")),
        Rung(N_("temperature"), "− kT·ΔT", -ladder.temperature, share("temperature")),
        Rung(N_("position"), "− (k1·x² + k2·x + k4)", -ladder.position, share("calibration")),
        Rung(N_("friction that is not the usual"), "− kF·ΔT_F", -ladder.friction, share("friction")),
        Rung(N_("what is left: the preload alone"), "g", ladder.feature, share("between_session")),
    ]


def _windows(view: MeasurementView) -> list[tuple[int, object]]:
    return list(enumerate(view.windows, start=1))


#: The picture reaches beyond the band by its width, and by so many hertz at least.
_LEAST_REACH_HZ: Final = 40.0
#: Windows that are drawn, and rows of the table of a response.
MOST_WINDOWS, _ROWS = 2, 24
_UNITS: Final = {
    "accelerance": "m/(s²·N)",
    "torque_accelerance": "m/(s²·N·m)",
    "current_accelerance": "m/(s²·A)",
    "transmissibility": "",
    "angular_accelerance": "rad/(s²·N)",
    "torque_angular_accelerance": "rad/(s²·N·m)",
    "current_angular_accelerance": "rad/(s²·A)",
    "angular_accelerance_per_acceleration": "rad/m",
}
_EXCITATIONS: Final = {
    ExcitationQuantity.TORQUE: (N_("Torque"), N_("Torque over time")),
    ExcitationQuantity.FORCE: (N_("Force"), N_("Force over time")),
    ExcitationQuantity.CURRENT: (N_("Current"), N_("Current over time")),
    ExcitationQuantity.ACCELERATION: (N_("Commanded acceleration"), N_("Commanded acceleration over time")),
}
_RESPONSES: Final = {
    ResponseQuantity.ACCELERATION: (N_("Acceleration"), N_("Acceleration over time")),
    ResponseQuantity.VELOCITY: (N_("Velocity"), N_("Velocity over time")),
    ResponseQuantity.DISPLACEMENT: (N_("Displacement"), N_("Displacement over time")),
    ResponseQuantity.MOTOR_ANGLE: (N_("Motor angle"), N_("Motor angle over time")),
    ResponseQuantity.MOTOR_SPEED: (N_("Motor speed"), N_("Motor speed over time")),
    ResponseQuantity.RELATIVE_DISPLACEMENT: (N_("Relative displacement"), N_("Relative displacement over time")),
}


@dataclass(frozen=True, slots=True)
class ResponseRow:
    """One line of a response, in numbers."""

    frequency: float
    magnitude: float
    baseline: float | None
    phase: float
    coherence: float | None


@dataclass(frozen=True, slots=True)
class ResponsePictures:
    """Pictures of a response, and the same in numbers."""

    magnitude: Charts
    phase: Charts
    coherence: Charts | None
    unit: str
    rows: list[ResponseRow]
    n_baseline: int


@dataclass(frozen=True, slots=True)
class WindowPicture:
    """One window over time."""

    number: int
    excitation: Charts
    response: Charts
    excitation_named: str  # with its unit
    response_named: str


def response_pictures(words: Words, responses: Responses, picked: float | None) -> ResponsePictures | None:
    """Draw magnitude, phase and coherence around the band of the mode; None where there is no response."""
    if responses.measured is None or responses.band is None:
        return None
    low, high = responses.band
    reach = max(high - low, _LEAST_REACH_HZ)
    measured = _around(responses.measured, low - reach, high + reach)
    baseline = None if responses.baseline is None else _around(responses.baseline, low - reach, high + reach)
    unit = _UNITS.get(measured.quantity, "")

    def draw(
        title: str, y_unit: str, value: Callable[[FrequencyResponse], FloatArray | None],
        frames: tuple[Frame, Frame], *, logarithmic: bool = False, limits: tuple[float, float] | None = None,
    ) -> Charts | None:  # fmt: skip
        curves = [
            Curve(response.frequency, values, style)
            for response, style in ((baseline, "reference"), (measured, "measured"))
            if response is not None and (values := value(response)) is not None
        ]
        if not curves:
            return None
        picture = LinePicture(title, "Hz", y_unit, curves, responses.band, picked, logarithmic, limits)
        return twice(words, partial(line_chart, picture), *frames)

    magnitude = draw(
        words(N_("Size of the response over frequency")), unit, lambda r: np.abs(r.response), (WIDE, NARROW),
        logarithmic=True,
    )  # fmt: skip
    phase = draw(
        words(N_("Phase of the response over frequency")), "°", _phase, (LOW_WIDE, LOW_NARROW), limits=(-180.0, 180.0)
    )
    coherence = draw(
        words(N_("Coherence over frequency")), "", lambda r: r.coherence, (LOW_WIDE, LOW_NARROW), limits=(0.0, 1.0)
    )
    if magnitude is None or phase is None:
        return None
    return ResponsePictures(magnitude, phase, coherence, unit, _rows(measured, baseline), responses.n_baseline)


def window_pictures(words: Words, windows: Sequence[Window]) -> list[WindowPicture]:
    """Draw the first windows over time."""
    drawn = []
    for number, window in enumerate(windows[:MOST_WINDOWS], start=1):
        seconds = np.arange(window.n_samples) / window.sample_rate
        of_excitation, of_response = window.excitation_quantity, window.response_quantity
        (excited, excited_over_time), (answer, answer_over_time) = _EXCITATIONS[of_excitation], _RESPONSES[of_response]
        channels = (
            (words(excited_over_time), of_excitation.unit, window.excitation),
            (words(answer_over_time), of_response.unit, window.response),
        )
        excitation, response = (
            twice(words, partial(line_chart, LinePicture(title, "s", y_unit, [curve])), LOW_WIDE, LOW_NARROW)
            for title, y_unit, samples in channels
            for curve in [Curve(seconds, np.asarray(samples, np.float64), "measured")]
        )
        named = (f"{words(excited)}, {of_excitation.unit}", f"{words(answer)}, {of_response.unit}")
        drawn.append(WindowPicture(number, excitation, response, *named))
    return drawn


def _around(response: FrequencyResponse, low: float, high: float) -> FrequencyResponse:
    inside = (response.frequency >= low) & (response.frequency <= high)
    coherence = None if response.coherence is None else response.coherence[inside]
    return FrequencyResponse(
        response.frequency[inside], response.response[inside], response.quantity, coherence, response.n_averages
    )


def _phase(response: FrequencyResponse) -> FloatArray:
    return np.asarray(np.degrees(np.angle(response.response)), dtype=np.float64)


def _rows(measured: FrequencyResponse, baseline: FrequencyResponse | None) -> list[ResponseRow]:
    """Return lines at equal distances, that of the largest response among them."""
    size, phases = np.abs(measured.response), _phase(measured)
    of_baseline = (
        None if baseline is None else np.interp(measured.frequency, baseline.frequency, np.abs(baseline.response))
    )
    chosen = {*np.linspace(0, size.size - 1, _ROWS).astype(int).tolist(), int(np.argmax(size))}
    return [
        ResponseRow(
            float(measured.frequency[i]),
            float(size[i]),
            None if of_baseline is None else float(of_baseline[i]),
            float(phases[i]),
            None if measured.coherence is None else float(measured.coherence[i]),
        )
        for i in sorted(chosen)
    ]
