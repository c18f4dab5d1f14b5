"""What a report and its JSON say of a wrong record, and which tolerances the command line takes."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from monitor_core.discrepancy import Outcome, RecordFault, SettingTolerances, WrongRecord
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.stated_tolerances import read_tolerances
from service.cli.inputs.data import Data, DataKind
from service.cli.inputs.model import tolerances_of
from service.documents.explanation import explanation_document
from service.report.verdict import asides
from tests.service.explanation_examples import EXAMPLES, MODEL

POSITION = WrongRecord(
    17, (32, 33), "500 mm, 220 N", RecordFault.POSITION, 88.0, 21.0, 500.0, 549.0, 2.0, "mm"
)  # fmt: skip


def told(record):
    example = replace(EXAMPLES[Outcome.NAMED], records=(record,))
    return next(sentence for sentence in asides(example) if "Record" in sentence), explanation_document(example, MODEL)


def test_a_wrong_tag_is_told_with_its_record_and_its_error() -> None:
    sentence, document = told(POSITION)
    assert sentence.startswith(
        "Record 17 (500 mm, 220 N) is wrong: its position is 49.0 ± 2.0 mm further than stated (ΔBIC 88.0)"
    )  # fmt: skip
    (record,) = document["records"]
    assert {key: record[key] for key in ("record", "kind", "stated", "found", "unit", "delta_bic")} == {
        "record": "conditions/0032", "kind": "position-tag", "stated": 500.0, "found": 549.0, "unit": "mm",
        "delta_bic": 88.0,
    }  # fmt: skip
    assert record["responses"] == [32, 33]


@pytest.mark.parametrize(
    ("fault", "found", "unit", "words"),
    [
        (RecordFault.PRELOAD, 470.0, "N", "its preload is 30.0 ± 2.0 N lower than stated"),
        (RecordFault.PAYLOAD, 506.0, "kg", "its payload is 6.0 ± 2.0 kg more than stated"),
        (RecordFault.TEMPERATURE, 515.0, "K", "it is 15.0 ± 2.0 K warmer than stated"),
        (RecordFault.GAIN, 1.3, "1", "its gain is 1.3 ± 2.0 times what it should be"),
    ],
)
def test_other_faults_are_told(fault, found, unit, words) -> None:
    assert words in told(replace(POSITION, fault=fault, found=found, unit=unit))[0]


def test_an_outlier_has_no_value_of_its_own() -> None:
    sentence, document = told(WrongRecord(3, (2,), "300 mm", RecordFault.OUTLIER, 400.0, 12.0))
    assert "it is 12 standard deviations from what the others say" in sentence
    assert document["records"][0]["found"] is None


def frf_set(path, **attributes):
    with h5py.File(path, "w") as file:
        file.attrs.update(attributes)
    return Data((path,), DataKind.FRF_SET, None)


def test_tolerances_are_those_of_the_file_unless_the_command_line_states_others(tmp_path) -> None:
    data = frf_set(tmp_path / "a.frf.h5", position_tolerance_mm=1.5, preload_tolerance=0.1, payload_tolerance_kg=0.2)
    assert tolerances_of(data, []) == SettingTolerances(1.5e-3, 0.1, payload=0.2)
    stated = [("position_tolerance_mm", 0.8), ("gain_tolerance", 0.02)]
    assert tolerances_of(data, stated) == SettingTolerances(0.8e-3, 0.1, 0.02, payload=0.2)
    assert tolerances_of(frf_set(tmp_path / "b.frf.h5"), []) == SettingTolerances()


def test_a_tolerance_that_is_no_positive_number_is_refused(tmp_path) -> None:
    data = frf_set(tmp_path / "a.frf.h5", position_tolerance_mm=np.float64(-1.0))
    with pytest.raises(RecordingFormatError, match="position_tolerance_mm: expected a positive number"):
        read_tolerances(data.file)
