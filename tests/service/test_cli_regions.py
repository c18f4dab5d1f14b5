"""Fig. 8 of Nguyen et al. (2018): three preload levels at three positions, told apart by repeated readings."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats

from tests.conftest import PROJECT_ROOT

TABLE_2 = PROJECT_ROOT / "replay_data" / "published" / "nguyen_table2.csv"


@pytest.fixture
def calibration(preload: Any, tmp_path: Path) -> Path:
    preload("calibrate", TABLE_2, "--out", tmp_path / "axis.json")
    return tmp_path / "axis.json"


def readings(path: Path, scatter_hz: float) -> Path:
    """Write 20 frequencies at each of 100, 200, 300 N and 250, 500, 750 mm, by Eq. (8) as Table 2 gives it."""
    rng = np.random.default_rng(8)
    with TABLE_2.open(encoding="utf-8") as stream:
        table = np.loadtxt(stream, delimiter=",", skiprows=1)
    lines = ["preload_n,position_mm,frequency_hz"]
    for level, position, frequency, *_ in table[np.isin(table[:, 0], (100.0, 200.0, 300.0))]:
        lines += [f"{level},{position},{f}" for f in rng.normal(frequency, scatter_hz, 20)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_three_levels_of_the_paper_are_apart_at_all_positions(preload: Any, tmp_path: Path, calibration: Path) -> None:
    """The paper: no overlap, standard deviations from 2 N at 100 N to 36 N at 300 N; so with 0.3 Hz."""
    told = preload("estimate", readings(tmp_path / "r.csv", 0.3), "--calibration", calibration, "--json").json()
    regions = told["regions"]
    assert len(regions) == 9
    assert all(region["apart_from_other_levels"] and region["n_readings"] == 20 for region in regions)
    widths = [np.diff(region["mean_interval_95_n"]).item() for region in regions]
    assert np.mean(widths[:3]) < np.mean(widths[3:6]) < np.mean(widths[6:])
    own = [item["preload_n"] for item in told["estimates"][:20]]  # the first level at the first position
    ends = scipy.stats.t.interval(0.95, 19, np.mean(own), scipy.stats.sem(own))
    assert regions[0]["mean_interval_95_n"] == pytest.approx(ends)


def test_levels_that_scatter_more_than_they_differ_overlap(preload: Any, tmp_path: Path, calibration: Path) -> None:
    words = ("estimate", readings(tmp_path / "r.csv", 3.0), "--calibration", calibration)
    regions = preload(*words, "--json").json()["regions"]
    assert not all(region["apart_from_other_levels"] for region in regions)
    assert "overlap" in preload(*words).out


def test_one_level_alone_is_neither_apart_nor_overlaps(preload: Any, tmp_path: Path, calibration: Path) -> None:
    head, *rest = readings(tmp_path / "r.csv", 0.3).read_text(encoding="utf-8").splitlines()
    level = rest[0].split(",")[0]
    (tmp_path / "one.csv").write_text("\n".join([head, *(r for r in rest if r.startswith(f"{level},"))]) + "\n")
    words = ("estimate", tmp_path / "one.csv", "--calibration", calibration)
    regions = preload(*words, "--json").json()["regions"]
    assert [region["apart_from_other_levels"] for region in regions] == [None] * 3


def test_single_readings_make_no_region(preload: Any, calibration: Path) -> None:
    assert preload("estimate", TABLE_2, "--calibration", calibration, "--json").json()["regions"] == []
