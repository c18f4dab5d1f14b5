"""Cases as files, and as the observations that a reader of the files makes of them: where truth and product meet."""

from pathlib import Path

from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.recordings.frf_set import FrequencyResponseSet, MeasuredResponse, write_frf_set
from tests.hidden_effects.cases import Case
from tests.hidden_effects.truth.axis import Setting


def write_case(case: Case, folder: Path, name: str = "case") -> tuple[Path, Path]:
    """Write what the workflow is given of a case and return both paths: the FRF set and the baseline."""
    responses, baseline = folder / f"{name}.frf.h5", folder / f"{name}.toml"
    write_frf_set(
        responses, FrequencyResponseSet(tuple(MeasuredResponse(observation) for observation in observations(case)))
    )
    baseline.write_text(case.baseline, encoding="utf-8")
    return responses, baseline


def observations(case: Case) -> tuple[FrequencyResponseObservation, ...]:
    """Return the responses of a case in the order in which they were measured."""
    return tuple(
        FrequencyResponseObservation(
            stated_conditions(frf.stated),
            frf.frequency,
            frf.response,
            frf.standard_deviation,
            ExcitationPoint.TORQUE_AT_MOTOR,
            ResponsePoint(frf.output),
            frf.resolution,
        )
        for frf in case.measured
    )


def stated_conditions(stated: Setting) -> DriveConditions:
    """Return the conditions that a measurement is tagged with."""
    return DriveConditions(
        position=stated.position,
        preload=stated.preload,
        payload_mass=stated.payload,
        temperature_deviation=stated.temperature_deviation,
        excitation_level=stated.excitation_rms,
    )
