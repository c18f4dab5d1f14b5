"""What the workflow makes of published data: Nguyen's Table 2 against Table 1 as printed.

``python -m benchmarks.published_discrepancies`` takes a minute or two.
"""

from dataclasses import replace
from pathlib import Path

from monitor_core.recordings.modal_csv import read_modal_table
from monitor_core.recordings.model_file import read_model_file
from service.operations.explanation import ExplanationRequest, explain_measurements
from service.operations.explanation_report import explanation_markdown
from service.operations.measured_responses import modal_observation

REPLAY_DATA = Path(__file__).resolve().parent.parent / "replay_data"


def main() -> None:
    """Print the report."""
    corrected = read_model_file(REPLAY_DATA / "models" / "lumped.toml")
    printed = replace(corrected, parameters={**corrected.parameters, "bracket_stiffness_n_per_m": 2.1e7})
    rows = read_modal_table(REPLAY_DATA / "published" / "nguyen_table2.csv")
    request = ExplanationRequest(printed, tuple(modal_observation(row) for row in rows))
    explanation, model = explain_measurements(request, print)
    print(explanation_markdown(explanation, model, "Table 2 of Nguyen et al. (2018) against Table 1 as printed"))


if __name__ == "__main__":
    main()
