"""Let the workflow answer a case with all of its candidates."""

from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.conditions.settings import default_folds
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.fitting.residuals.responses import compare_responses
from monitor_core.models.families import build_model
from monitor_core.recordings.model_file import parse_model
from tests.hidden_effects.frf_file import observations


def compared(case):
    """Return the comparison of a case, and the axis as it is described."""
    file, measured = parse_model(case.baseline, "a case"), observations(case)
    drive = DescribedDrive(build_model(file.family, file.parameters).parameters, dict(file.uncertain), {})
    folds = default_folds(observation.conditions for observation in measured)
    return compare_responses(measured, held_out=folds), drive


def answered(case, progress=None):
    """Return what the workflow makes of a case; ``progress`` is called with what it does."""
    comparison, drive = compared(case)
    candidates = drive.candidates(sizes_of_drive(drive.physics({}), observations(case)))
    return explain_comparison(comparison, drive, candidates, progress=progress)
