"""Where the preload would go if it went on as it does now."""

import sqlite3
from contextlib import closing
from datetime import timedelta

import numpy as np

from monitor_core.preload import preload_from_feature
from monitor_core.recordings.calibration_file import calibration_from_document
from tests.service.conftest import START, Api, simulated_measurement

DAY_US = 86400 * 10**6


def test_the_projection_has_the_slope_with_which_preload_is_lost(api: Api) -> None:
    """Sixty sessions, one a day, of a preload that falls by 0.5 N a day from 300 N and scatters by 2 N."""
    api.register("worn")
    number = api.calibrate("worn")
    api.accept("worn", simulated_measurement(np.random.default_rng(1), "first", started_at=START))
    document = api.http.get(f"/v1/axes/worn/calibrations/{number}").json()["document"]
    coefficients = calibration_from_document(document).coefficients
    days = np.arange(60)
    preload = 300.0 - 0.5 * days + 2.0 * np.random.default_rng(5).normal(size=60)
    some = 4.4e-6
    features = some * (preload / preload_from_feature(some, coefficients)) ** (-1.0 / 3.0)
    first = int((START - timedelta(days=61)).timestamp() * 10**6)
    with closing(sqlite3.connect(api.data_dir / "preload.db")) as connection:
        connection.executemany(
            "INSERT INTO sessions (axis_number, calibration_id, started_at, epoch, last_at, n_measurements, "
            "feature_s2, alarmed) SELECT number, active_calibration_id, ?, epoch, ?, 3, ?, 0 FROM axes",
            [
                (at, at, feature)
                for at, feature in zip((first + days * DAY_US).tolist(), features.tolist(), strict=True)
            ],
        )
        connection.commit()
    projected = api.http.get("/v1/axes/worn/projection").json()
    lower, upper = projected["interval_95_n_per_day"]
    assert projected["n_sessions"] == 60
    assert lower < -0.5 < upper < 0.0
    later = projected["points"][-1]
    lower, upper = later["interval_95_n"]
    assert lower < later["preload_n"] < upper
    assert later["preload_n"] < 270.0
