"""Identify the joints of an axis from stored measurements or posted peaks: jobs of kind ``identification``."""

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import ConfigDict, Field

from monitor_core.recording import ExcitationSource
from monitor_core.uncertainty import Estimate
from service.operations.analysis_job import (
    AnalysisArguments,
    Answer,
    Measured,
)
from service.operations.fields import Frequency, JointLimit, Place, RequestModel, ScatterHz, SetPreload, exactly_one_of
from service.operations.own_process import Progress, Report

if TYPE_CHECKING:
    from monitor_core.identification import IdentifyOptions, PredictionRequest


class PredictionIn(RequestModel):
    """A calibration to be predicted from the joints: of which mode, and at which preload they were measured."""

    mode_hz: Annotated[
        tuple[Frequency, Frequency],
        Field(description="holds the mode that will be monitored, alone at every position and preload"),
    ]
    preload_n: SetPreload
    preload_standard_uncertainty_n: SetPreload
    scatter_hz: Annotated[ScatterHz, Field(description="between measurements of one setting")]
    excitation_source: Literal["sensor", "drive"] = "sensor"

    def to_core(self) -> "PredictionRequest":
        """Return the core's record."""
        from monitor_core.identification import PredictionRequest  # noqa: PLC0415  # a start pays for no analysis

        preload = Estimate(self.preload_n, self.preload_standard_uncertainty_n)
        return PredictionRequest(self.mode_hz, preload, self.scatter_hz, ExcitationSource(self.excitation_source))


class IdentificationIn(AnalysisArguments):
    """Whose joints, and from what: stored measurements, or peaks."""

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": exactly_one_of("measurements", "peaks"),
            "examples": [
                {"model": 'family = "receptance"\n[parameters]\n…', "measurements": {}, "hold_out_mm": [500.0]}
            ],
        },
    )

    described_by = "model"
    kind = "identification"
    first = Progress(0)

    model: Annotated[str, Field(max_length=20_000, description="drive model as TOML")]
    hold_out_mm: Annotated[list[Place], Field(max_length=100)] = Field(
        default=[], description="positions that the fit does not see and is judged by; without any, each in turn"
    )
    limits: dict[str, tuple[JointLimit, JointLimit]] = Field(
        default={}, max_length=20, description="lower and upper limit of a free joint, by its name in the model"
    )
    objective: Literal["weighted", "eq-26"] = "weighted"
    prediction: PredictionIn | None = Field(default=None, description="also predict k1…k4, to be used as a prior")
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 1

    def require(self, measured: Measured) -> None:
        """Refuse at once what cannot be identified; raises MonitorCoreError with the reason in one sentence."""
        from monitor_core.identification import require_identifiable  # noqa: PLC0415  # a start pays for no analysis

        require_identifiable(self.axis(), measured.observations, self._options(measured))

    def answer(self, axis_id: str, measured: Measured, report: Report) -> Answer:
        """Identify the joints; the document is the JSON of ``preload identify``."""
        from monitor_core.identification import identify  # noqa: PLC0415  # a start pays for no analysis
        from service.documents.identification import identification_document  # noqa: PLC0415

        del axis_id
        joints = identify(
            self.axis(),
            measured.observations,
            self._options(measured),
            progress=lambda done, total: report(Progress(done, total)),
        )
        return Answer(identification_document(joints))

    def _options(self, measured: Measured) -> "IdentifyOptions":
        from monitor_core.identification import IdentifyOptions  # noqa: PLC0415  # a start pays for no analysis
        from service.documents.identification import OBJECTIVES  # noqa: PLC0415

        return IdentifyOptions(
            hold_out=self.hold_out,
            limits=self.limits,
            weighting=OBJECTIVES[self.objective],
            seed=self.seed,
            prediction=None if self.prediction is None else self.prediction.to_core(),
            accelerometer=self.accelerometer,
            assumptions=measured.assumptions,
        )
