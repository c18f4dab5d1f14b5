"""What an identification or an explanation is given of judged measurements."""

from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

from monitor_core.modal import ModalMeasurement, ModeGate, measure_mode
from monitor_core.recordings.session_hdf5 import read_session
from service.operations.measured_responses import STRIDE, measured_responses

SESSION = Path(__file__).parents[2] / "replay_data" / "healthy-month.session.h5"
BAND = (110.0, 260.0)


WINDOWS = list(next(groupby(read_session(SESSION).windows, key=lambda window: window.measurement))[1])


def test_a_response_says_how_fine_it_was_seen() -> None:
    """Averages over Hann windows are smeared by the reciprocal of their duration; those of a bare cut state nothing."""
    measurement = measure_mode(WINDOWS, band=BAND, gate=ModeGate())
    assert isinstance(measurement, ModalMeasurement)
    (seen,) = measured_responses([replace(measurement, taper="hann")])
    assert seen.resolution == pytest.approx(WINDOWS[0].sample_rate / WINDOWS[0].response.size)
    assert min(np.diff(seen.frequency)) > 0.999 * STRIDE["hann"] * seen.resolution
    (bare,) = measured_responses([replace(measurement, taper="rectangular")])
    assert bare.resolution == 0.0
