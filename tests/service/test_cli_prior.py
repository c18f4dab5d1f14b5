"""``preload calibrate DATA --prior FILE``: few readings joined with a calibration that was there before."""

from collections.abc import Iterable
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_core.preload import CoefficientPrior, ModalReading, ValidRange, calibration_from_prior
from monitor_core.recording import Session
from monitor_core.recordings.calibration_file import write_calibration
from monitor_core.recordings.model_file import write_model_file
from monitor_core.recordings.session_hdf5 import read_session, write_session
from monitor_core.uncertainty import VectorEstimate
from tests.conftest import canary
from tests.identification.test_described_calibration import AXES, Plant
from tests.service.conftest import START, simulated_window
from tests.service.test_cli import K_NAMES, assert_refused

SESSIONS = Path(__file__).resolve().parents[2] / "replay_data"

#: Nguyen's k from the whole of Table 2, and standard uncertainties of 5 %, as of a prediction that is right.
K = np.array([-4848.6e-8, 5741.6e-8, 1915.2e-8, 1154.6e-8])


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write every second measurement of the bundled calibration session: all preloads, payloads and temperatures."""
    whole = read_session(SESSIONS / "calibration.session.h5")
    path = tmp_path_factory.mktemp("session") / "short.session.h5"
    windows = tuple(window for name in whole.measurements[::2] for window in whole.windows_of(name))
    write_session(path, Session(whole.axis_id, windows))
    return path


@pytest.fixture
def table_of(published_data: Path, tmp_path: Path) -> Any:
    """Write a modal table with some rows of Nguyen's Table 2, by number."""
    header, *rows = (published_data / "nguyen_table2.csv").read_text(encoding="utf-8").splitlines()

    def write(name: str, numbers: Iterable[int], *, faster: float = 0.0) -> Path:
        names = header.split(",")
        lines = []
        for number in numbers:
            cells = dict(zip(names, rows[number].split(","), strict=True))
            kept = (cells["position_mm"], str(float(cells["frequency_hz"]) + faster), cells["preload_n"])
            lines.append(",".join(kept))
        path = tmp_path / name
        path.write_text("\n".join(["position_mm,frequency_hz,preload_n", *lines]) + "\n", encoding="utf-8")
        return path

    return write


@pytest.fixture
def predicted(tmp_path: Path) -> Path:
    prior = CoefficientPrior(
        VectorEstimate(K, np.diag((0.05 * K) ** 2)), 0.25, ValidRange(0.25, 0.75), ValidRange(50.0, 400.0), "joints"
    )
    path = tmp_path / "predicted.json"
    write_calibration(path, calibration_from_prior(prior))
    return path


def test_two_rows_will_do_with_a_prior(preload: Any, table_of: Any, predicted: Path, tmp_path: Path) -> None:
    two, out = table_of("two.csv", (1, 16)), tmp_path / "joined.json"
    assert_refused(preload("calibrate", two), "a calibration needs, at one payload, at least three positions")
    document = preload("calibrate", two, "--prior", predicted, "--out", out, "--json").json()
    assert document["prior"] == "predicted.json"
    assert document["n_readings"] == 2
    assert np.all(np.diag(document["covariance"]) < (0.05 * K) ** 2)
    assert document["valid_range"]["preload_n"] == [50.0, 400.0]
    assert "predicted.json" in preload("calibrate", two, "--prior", predicted).out
    estimates = preload("estimate", two, "--calibration", out, "--json").json()["estimates"]
    assert all(e["interval_95_n"][0] < e["interval_95_n"][1] for e in estimates)


def test_half_a_table_and_the_other_half_are_the_whole(preload: Any, table_of: Any, tmp_path: Path) -> None:
    first = tmp_path / "first.json"
    assert preload("calibrate", table_of("even.csv", range(0, 18, 2)), "--out", first).exit_code == 0
    odd = table_of("odd.csv", range(1, 18, 2))
    document = preload("calibrate", odd, "--prior", first, "--json").json()
    values = np.array([document["coefficients"][name] for name in K_NAMES])
    uncertainty = np.sqrt(np.diag(document["covariance"]))
    # the scatter is estimated from each half a little differently; see the tests of the regression
    assert np.abs(values - K) / uncertainty == pytest.approx([0.0] * 4, abs=0.2)


def test_a_prediction_alone_estimates_with_its_own_uncertainty(preload: Any, table_of: Any, predicted: Path) -> None:
    """The same k as from the table, so the same newtons; intervals as of k known to 5 %, not to the table's scatter."""
    whole, out = table_of("all.csv", range(18)), predicted.with_name("whole.json")
    preload("calibrate", whole, "--out", out)
    alone, fitted = (
        preload("estimate", whole, "--calibration", file, "--json").json()["estimates"] for file in (predicted, out)
    )
    assert [e["preload_n"] for e in alone] == pytest.approx([e["preload_n"] for e in fitted], rel=1e-3)
    assert all(e["interval_95_n"][0] < 0.5 * f["interval_95_n"][0] for e, f in zip(alone, fitted, strict=True))


@pytest.mark.release
def test_what_does_not_go_with_a_prior_is_refused(
    preload: Any, table_of: Any, predicted: Path, session: Path, tmp_path: Path
) -> None:
    two = table_of("two.csv", (1, 16))
    assert_refused(preload("calibrate", two, "--prior", tmp_path / "none.json"), "none.json")
    assert_refused(preload("calibrate", two, "--prior", two), "two.csv: expected a calibration; got a modal table")
    faster = table_of("faster.csv", (1, 16), faster=40.0)
    assert_refused(
        preload("calibrate", faster, "--prior", predicted), "the readings contradict the prior (predicted.json)"
    )
    of_another_axis = preload("calibrate", session, "--band-hz", 140, 230, "--prior", predicted)
    assert_refused(of_another_axis, "the readings contradict the prior (predicted.json)")


@pytest.mark.release
def test_a_session_joins_its_own_calibration(preload: Any, session: Path, tmp_path: Path) -> None:
    first = tmp_path / "first.json"
    once = preload("calibrate", session, "--band-hz", 140, 230, "--out", first, "--json").json()
    again = preload("calibrate", session, "--band-hz", 140, 230, "--prior", first, "--json").json()
    assert again["prior"] == "first.json"
    assert again["coefficients"] == pytest.approx(once["coefficients"], rel=1e-6, abs=0.0)
    # The same readings twice leave the same residuals twice, but fit the four coefficients once: the joined ones have
    # up to four degrees of freedom more than twice those of the first. With more, the variance is less than half.
    first_dof, dof = once["degrees_of_freedom"], again["degrees_of_freedom"]
    assert 2.0 * first_dof < dof < 2.0 * first_dof + 4.0
    ratio = (np.diag(again["covariance"]) / np.diag(once["covariance"]))[:4]  # behind them: payload and temperature
    assert ratio == pytest.approx([0.5 * 2.0 * first_dof / dof] * 4, rel=1e-3)


def test_a_drive_model_will_do_where_no_preload_was_set(preload: Any, predicted: Path, tmp_path: Path) -> None:
    """Three readings of a finite-element axis whose nut nobody measured; a later one after half is lost is covered."""
    plant = Plant(AXES["large"], np.random.default_rng(7))
    model, table, out = tmp_path / "axis.toml", tmp_path / "unset.csv", tmp_path / "wide.json"
    write_model_file(model, AXES["large"])

    def write(readings: Iterable[ModalReading]) -> None:
        rows = [f"{1e3 * r.conditions.position},{r.frequency},0" for r in readings]
        table.write_text("\n".join(["position_mm,frequency_hz,payload_kg", *rows]) + "\n", encoding="utf-8")

    write(plant.reading(share) for share in (0.3, 0.5, 0.7))
    assert_refused(preload("calibrate", table), "a calibration needs the preload of every reading")
    assert_refused(preload("calibrate", table, "--model", model, "--prior", predicted), "one of --prior and --model")
    assert_refused(preload("calibrate", table, "--preload-n", 300, 30), "--preload-n goes with --model")
    of_nut = ("--preload-n", 1.1 * plant.preload, 0.2 * plant.preload)  # as its maker says, who has not measured it
    said = preload("calibrate", table, "--model", model, *of_nut, "--out", out)
    assert said.exit_code == 0
    assert "none: no preload was set" in said.out
    write([plant.reading(0.6, 0.5)])
    (estimate,) = preload("estimate", table, "--calibration", out, "--json").json()["estimates"]
    low, high = estimate["interval_95_n"]
    assert low < 0.5 * plant.preload < high
    assert 1.4**2 < high / low < 1.8**2  # what is known of the nut, a factor of 1.43 either way, and a bit


@pytest.mark.parametrize("one_is_known", canary([False, True]))
def test_a_drive_model_joins_a_session(preload: Any, tmp_path: Path, one_is_known: bool) -> None:
    """Windows of the same kind of axis, three measurements, of one of which the preload was set, or of none."""
    plant, rng = Plant(AXES["small"], np.random.default_rng(8)), np.random.default_rng(9)
    model, recorded, out = tmp_path / "axis.toml", tmp_path / "unset.session.h5", tmp_path / "wide.json"
    write_model_file(model, AXES["small"])
    readings = [plant.reading(share, stated=one_is_known and share == 0.5) for share in (0.3, 0.5, 0.7)]
    windows = [
        simulated_window(
            rng, reading.frequency, started_at=START + timedelta(seconds=60 * number + 2 * i),
            conditions=reading.conditions, measurement=f"m{number}",
        )
        for number, reading in enumerate(readings)
        for i in range(4)
    ]  # fmt: skip
    write_session(recorded, Session("axis", tuple(windows)))
    said = preload("calibrate", recorded, "--band-hz", 120, 300, "--model", model, "--out", out, "--json").json()
    assert said["n_readings"] == int(one_is_known)
    table, later = tmp_path / "later.csv", plant.reading(0.6, 0.6)
    row = f"{1e3 * later.conditions.position},{later.frequency},0"
    table.write_text(f"position_mm,frequency_hz,payload_kg\n{row}\n", encoding="utf-8")
    (estimate,) = preload("estimate", table, "--calibration", out, "--json").json()["estimates"]
    low, high = estimate["interval_95_n"]
    assert low < 0.6 * plant.preload < high
    assert (high / low > 1.86**2) is not one_is_known
