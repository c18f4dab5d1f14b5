"""``/axes/{axis}/measurements/{measurement}``: why this value."""

from dataclasses import dataclass
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel

from monitor_core.modal import GateReading
from monitor_core.preload import PreloadLadder
from service.api.access import needs
from service.api.services import Services, services
from service.api.trend import judgement_out
from service.documents.said import N_
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId, RowId
from service.operations.monitoring.trend import MeasurementView
from service.web.axis import Last
from service.web.response_view import response_pictures, window_pictures
from service.web.site import PageOf

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


class _Said(BaseModel):
    """What the page shows of a measurement besides what an axis shows of its last one."""

    frequency_hz: float | None = None
    calibration: int | None = None
    warnings: list[str] = []
    assumptions: list[str] = []


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
    axis: AxisId, measurement: RowId, page: PageOf, on: Annotated[Services, Depends(services)]
) -> Response:
    """Show why a measurement has its value."""
    view = on.trend.measurement(axis, measurement)
    last, said = Last.model_validate(view.outcome or {}), _Said.model_validate(view.outcome or {})
    evidence = on.evidence.of(axis, view)
    found, ladder = evidence.responses(), evidence.ladder()
    before, following = evidence.neighbours()
    return page.show(
        "measurement.html",
        axis=on.trend.status(axis).row,
        row=view.row,
        last=last,
        said_of_it=said,
        gates=_gates(evidence.gates(), last),
        advice=_advice(on, last),
        ladder=ladder,
        rungs=[] if ladder is None else _rungs(ladder, last.variance_shares),
        pictures=response_pictures(page.words, found, said.frequency_hz),
        windows=_windows(view),
        drawn=window_pictures(page.words, found.windows),
        let_go=view.let_go,
        judgements=[judgement_out(judgement) for judgement in evidence.judgements()],
        before=before,
        following=following,
    )


def _gates(readings: tuple[GateReading, ...], last: Last) -> list[GateLine]:
    """Return the gates, and the one that refused if none of these did."""
    lines = [
        GateLine(GATES[str(read.gate)], read.unit, read.value, read.lower, read.upper, read.passed) for read in readings
    ]
    if last.refused and last.reason is not None and all(line.passed for line in lines):
        lines.append(GateLine(last.reason, "", None, None, None, passed=False))
    return lines


def _advice(on: Services, last: Last) -> list[object]:
    """Return what is known of a refusal, and of each doubt."""
    asked = [on.advice.of("refusal", last.reason)] if last.refused and last.reason else []
    asked += [on.advice.of("doubt", doubt.reason) for doubt in last.doubts]
    return [advice for advice in asked if advice is not None]


def _rungs(ladder: PreloadLadder, shares: dict[str, float]) -> list[Rung]:
    def share(*names: str) -> float | None:
        known = [shares[name] for name in names if name in shares]
        return sum(known) if known else None

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
