"""Explain what the model of an axis lacks, from stored measurements or posted peaks: jobs of kind ``discrepancy``."""

import time
from typing import TYPE_CHECKING, Annotated

from pydantic import BaseModel, ConfigDict, Field

from service.operations.analysis_job import (
    MOST_LISTED,
    AnalysisArguments,
    Answer,
    Measured,
)
from service.operations.fields import Number, Place, exactly_one_of
from service.operations.own_process import Progress, Report
from service.store import jobs
from service.store.database import Database
from service.store.tables import JobRow

if TYPE_CHECKING:
    from monitor_core.discrepancy import ExplainOptions


class DiscrepancyIn(AnalysisArguments):
    """What the axis is said to be, and what was measured of it: stored measurements, or peaks."""

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": exactly_one_of("measurements", "peaks"),
            "examples": [
                {"baseline": 'family = "lumped"\n[parameters]\n…', "measurements": {}, "hold_out_mm": [300.0, 600.0]}
            ],
        },
    )

    described_by = "baseline"
    kind = "discrepancy"
    first = Progress(1, None, "reading what was measured")

    baseline: Annotated[str, Field(max_length=20_000, description="drive model as TOML")]
    hold_out_mm: Annotated[list[Place], Field(max_length=100)] = Field(
        default=[],
        description="positions that the fit does not see and is judged by; without any, two inner ones of five or "
        "more, else each of four preloads or more in turn",
    )
    time_limit_s: Annotated[Number, Field(ge=1e-3, le=86_400)] | None = Field(
        default=None,
        description="after it the best answer so far is given, partial or unknown, with what was not tried",
    )

    def require(self, measured: Measured) -> None:
        """Refuse at once what cannot be explained; raises MonitorCoreError with the reason in one sentence."""
        from monitor_core.discrepancy import require_explainable  # noqa: PLC0415  # a start pays for no analysis

        require_explainable(self.axis(), measured.observations, self._options(measured))

    def answer(self, axis_id: str, measured: Measured, report: Report) -> Answer:
        """Explain; the document is the JSON of ``preload explain``, the page its report."""
        from monitor_core.discrepancy import explain  # noqa: PLC0415  # a start pays for no analysis
        from monitor_core.recordings.model_file import model_file_text  # noqa: PLC0415
        from service.documents.explanation import explanation_document  # noqa: PLC0415
        from service.report.page import explanation_page  # noqa: PLC0415

        sentences = [self.first.sentence]

        def progress(sentence: str) -> None:
            if sentences[-1] != sentence:
                sentences.append(sentence)
            report(Progress(len(sentences), None, sentence))

        axis, began = self.axis(), time.monotonic()
        explanation = explain(
            axis,
            measured.observations,
            self._options(measured),
            progress=progress,
            time_is_up=lambda: self.time_limit_s is not None and time.monotonic() - began >= self.time_limit_s,
        )
        model_text = model_file_text(explanation.augmented or axis)
        title = f"Axis {axis_id} against its {axis.family} model"
        return Answer(explanation_document(explanation, model_text), explanation_page(explanation, model_text, title))

    def _options(self, measured: Measured) -> "ExplainOptions":
        from monitor_core.discrepancy import ExplainOptions  # noqa: PLC0415  # a start pays for no analysis

        return ExplainOptions(
            hold_out=self.hold_out, accelerometer=self.accelerometer, assumptions=measured.assumptions
        )


class _FoundEffect(BaseModel):
    key: str


class FoundDiscrepancy(BaseModel):
    """What a comparison with the model found, in short; its report says it all."""

    outcome: str
    effects: list[_FoundEffect]


def finished_discrepancies(database: Database, axis_id: str) -> list[tuple[JobRow, FoundDiscrepancy]]:
    """Return the last jobs of an axis that came to an answer, newest first, each with what it found."""
    with database.read() as session:
        rows = jobs.finished_jobs(session, axis_id, DiscrepancyIn.kind, MOST_LISTED)
    return [(row, FoundDiscrepancy.model_validate(row.result)) for row in rows]
