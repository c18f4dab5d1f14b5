"""What the gates read is what they refuse by: one list, whether a measurement passes or not."""

import pytest

from monitor_core.modal import ModalMeasurement, ModeGate, ModeReadings, averaged_response, measure_mode, read_gates
from monitor_core.recording import Rejection, RejectionReason
from tests.modal.test_measure import windows_of

BAND = (150.0, 200.0)


@pytest.mark.parametrize(
    ("gate", "noise", "refused"),
    [
        (ModeGate(), 0.02, None),
        (ModeGate(minimum_averages=20), 0.02, RejectionReason.TOO_FEW_AVERAGES),
        (ModeGate(maximum_frequency_uncertainty=1e-6), 0.02, RejectionReason.UNCERTAIN_FREQUENCY),
        (ModeGate(minimum_coherence=1.0), 0.02, RejectionReason.LOW_COHERENCE),
    ],
)
def test_the_first_gate_that_fails_is_the_reason_of_the_refusal(
    gate: ModeGate, noise: float, refused: RejectionReason | None
) -> None:
    windows = windows_of(noise=noise)
    answer = measure_mode(windows, band=BAND, gate=gate)
    if refused is RejectionReason.TOO_FEW_AVERAGES:  # found before anything is averaged
        assert isinstance(answer, Rejection)
        assert answer.reason is refused
        return
    read = read_gates(windows, band=BAND, gate=gate)
    assert isinstance(read, ModeReadings)
    failed = [reading.gate for reading in read.gates if not reading.passed]
    assert failed[:1] == ([] if refused is None else [refused])
    if refused is None:
        assert isinstance(answer, ModalMeasurement)
        assert read.mode.frequency == answer.mode.frequency
    else:
        assert isinstance(answer, Rejection)
        assert answer.reason is refused


def test_a_response_on_more_lines_is_the_same_where_both_have_it() -> None:
    windows = windows_of()
    narrow, wide = (averaged_response(windows, lines) for lines in (BAND, (60.0, 400.0)))
    assert not isinstance(narrow, Rejection)
    assert not isinstance(wide, Rejection)
    assert wide.frequency[0] <= 61.0
    assert wide.frequency[-1] >= 399.0
    shared = (wide.frequency >= BAND[0]) & (wide.frequency <= BAND[1])
    assert wide.frequency[shared] == pytest.approx(narrow.frequency)
    assert abs(wide.response[shared]) == pytest.approx(abs(narrow.response), rel=0.05)
