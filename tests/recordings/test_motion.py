"""Motion records: round trip, a file of another program, and each way in which one may be wrong."""

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError, RecordingFormatError
from monitor_core.recording import ExcitationQuantity, MotionRecord
from monitor_core.recordings import check_file
from monitor_core.recordings.motion_csv import read_motion_record, write_motion_record

N = 200


def record(**changes):
    t = np.arange(N) / 1000.0
    values = {
        "sample_rate": 1000.0,
        "position": 0.1 * np.sin(3.0 * t) / 3.0,
        "drive": 20.0 * np.cos(3.0 * t),
        "quantity": ExcitationQuantity.FORCE,
        "reference": np.sin(3.0 * t),
    }
    return MotionRecord(**(values | changes))


def text(header="time_s,position_m,force_n", rows=None):
    rows = [f"{k / 1000:.3f},{k * 1e-5},{k % 7}" for k in range(N)] if rows is None else rows
    return "\n".join([header, *rows]) + "\n"


@pytest.mark.parametrize("quantity", [ExcitationQuantity.FORCE, ExcitationQuantity.TORQUE])
@pytest.mark.parametrize("reference", [None, np.linspace(0.0, 1.0, N)])
def test_what_is_written_is_read(tmp_path, quantity, reference):
    written = record(quantity=quantity, reference=reference)
    write_motion_record(tmp_path / "m.csv", written)
    read = read_motion_record(tmp_path / "m.csv")
    assert read.quantity is quantity
    assert read.sample_rate == pytest.approx(1000.0, rel=1e-12)
    for name in ("position", "drive", "reference"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    np.testing.assert_allclose(read.time, written.time, rtol=1e-12)


@pytest.mark.parametrize("quantity", [ExcitationQuantity.CURRENT, ExcitationQuantity.ACCELERATION])
def test_a_motion_is_driven_by_a_force_or_a_torque(quantity):
    with pytest.raises(OutsideValidityError, match=f"a motion needs a force or a torque; got {quantity}"):
        record(quantity=quantity)


def test_times_printed_to_a_millisecond_and_further_columns_are_taken(tmp_path):
    path = tmp_path / "m.csv"
    rows = [f"{k / 3000:.4f},{k},{k},x{k}".replace("x", "") for k in range(N)]
    path.write_text(text("time_s,position_m,torque_nm,current_a", rows))
    read = read_motion_record(path)
    assert read.sample_rate == pytest.approx(3000.0, rel=1e-3)
    assert read.quantity is ExcitationQuantity.TORQUE
    report = check_file(path)
    assert (report.format, report.valid, report.problems) == ("motion-record", True, ())


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (
            text("time_s,position_m,current_a"),
            "expected one of the columns force_n and torque_nm; got neither in time_s",
        ),
        (
            text("time_s,force_n,torque_nm"),
            "expected one of the columns force_n and torque_nm; got force_n and torque_nm",
        ),
        (text("time_s,place_m,force_n"), "expected a channel 'position_m'"),
        (text(rows=["0,0,0", "1,1,1"]), "at least 100 samples; got 2"),
        (text(rows=[f"{k},0,nan" for k in range(N)]), "drive must be finite; sample 0 is not"),
        (text(rows=[f"{k + 5 * (k > 50)},0,1" for k in range(N)]), "uniform sampling, every 1.0"),
        (text(rows=[f"{-k},0,1" for k in range(N)]), "expected times that rise; got 0 to -199 s"),
        (text(rows=["1,2"] * N), "expected 3 numbers separated by comma; got 2"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_sentence(tmp_path, content, sentence):
    path = tmp_path / "m.csv"
    path.write_text(content)
    with pytest.raises(RecordingFormatError) as refused:
        read_motion_record(path)
    assert sentence in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"sample_rate": 0.0}, "sample_rate must be positive"),
        ({"drive": np.zeros(3)}, "must be of one length; got drive of shape"),
        ({"position": np.zeros((N, 1))}, "must be of one length"),
    ],
)
def test_a_record_that_cannot_be_is_refused(changes, sentence):
    with pytest.raises(OutsideValidityError, match=sentence):
        record(**changes)
