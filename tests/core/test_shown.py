"""What a notebook is shown of a record: its picture holds its numbers, and so does its table; libraries may lack."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import monitor_core as mc
from monitor_core import recordings
from monitor_core.arrays import Shown
from monitor_core.discrepancy import FoundEffect, FoundParameter
from monitor_core.discrepancy.explain_axis import _NOTHING_ELSE
from monitor_core.errors import MissingReaderError
from monitor_core.models.generator import SimulationSettings
from monitor_core.shown import Panel
from tests.conftest import PROJECT_ROOT

K = (-4872e-8, 5561e-8, 2097e-8, 1228e-8)  # Table 3 of Nguyen et al. (2018)


def axial_frequency(x: float, preload: float) -> float:
    return float((K[0] * x**2 + K[1] * x + K[2] * preload ** (-1 / 3) + K[3]) ** -0.5)


@pytest.fixture(scope="module")
def calibration() -> mc.Calibration:
    readings = [
        mc.ModalReading(axial_frequency(x, preload), mc.Conditions(x, preload=preload))
        for x in (0.2, 0.4, 0.6)
        for preload in (100.0, 200.0, 300.0, 400.0)
    ]
    return mc.calibrate(readings, weighting="none", excitation_source=None)


@pytest.fixture(scope="module")
def trend() -> mc.Trend:
    """Two measurements at 200 N and one without a mode in the band."""
    model = recordings.read_model_file(PROJECT_ROOT / "replay_data/models/lumped.toml").build()
    settings = mc.AxisSettings(search_band=(150.0, 300.0))
    few = SimulationSettings(windows_per_measurement=8)

    def recorded(places: list[mc.DriveConditions], seed: int) -> mc.Session:
        start = datetime(2026, 3, 1 + seed, tzinfo=UTC)
        return mc.simulate_session(model, places, few, axis_id="x", started_at=start, rng=np.random.default_rng(seed))

    places = [mc.DriveConditions(x, preload=preload) for x in (0.2, 0.45, 0.7) for preload in (100.0, 200.0, 400.0)]
    calibration = mc.calibrate_session(recorded(places, 1), settings)
    healthy = [mc.DriveConditions(0.5, preload=200.0), mc.DriveConditions(0.6, preload=200.0)]
    judged = [*mc.judge_session(recorded(healthy, 2), settings, calibration)]
    [refused] = mc.judge_session(
        recorded(healthy[:1], 3), replace(settings, mode=replace(settings.mode, minimum_averages=1e3)), calibration
    )
    return mc.Trend([*judged, refused])


@pytest.fixture
def figures() -> Iterator[None]:
    with mpl.rc_context({"backend": "agg"}):
        yield
        pyplot.close("all")


def test_a_response_is_drawn_and_listed_as_it_is(figures: None) -> None:
    frequency = np.linspace(10.0, 200.0, 96)
    omega, resonance = 2 * np.pi * frequency, 2 * np.pi * 100.0
    response = -(omega**2) / (resonance**2 - omega**2 + 0.04j * resonance * omega)
    shown = mc.FrequencyResponse(frequency, response, "accelerance", np.full(96, 0.9), 15.0)
    size, phase, coherence = shown.plot().axes
    assert size.get_yscale() == "log"
    drawn = size.lines[0].get_xydata()
    assert drawn[np.argmax(drawn[:, 1]), 0] == 100.0
    assert phase.lines[0].get_ydata()[frequency == 100.0] == pytest.approx([90.0])  # an acceleration leads at resonance
    assert set(coherence.lines[0].get_ydata()) == {0.9}
    frame = shown.to_frame()
    assert np.array_equal(frame["real"] + 1j * frame["imaginary"], response)
    assert frame.columns.tolist() == ["frequency_hz", "real", "imaginary", "coherence"]
    modelled = replace(shown, coherence=None)
    assert len(modelled.plot().axes) == 2
    assert "coherence" not in modelled.to_frame()


def test_a_calibration_is_drawn_as_the_lines_of_eq_8(figures: None, calibration: mc.Calibration) -> None:
    [axes] = calibration.plot().axes
    lines = {line.get_label(): line for line in axes.lines}
    assert list(lines) == ["100 N", "200 N", "300 N", "400 N"]
    x, frequency = lines["300 N"].get_data()
    assert frequency == pytest.approx([axial_frequency(each, 300.0) for each in x])
    frame = calibration.to_frame().set_index("parameter")
    assert frame["value"].tolist() == pytest.approx(K)


def test_a_trend_says_when_and_how_much(figures: None, trend: mc.Trend) -> None:
    frame = trend.to_frame()
    assert frame["preload_n"][:2].between(150.0, 250.0).all()
    assert ((frame["lower_n"] < 200.0) & (frame["upper_n"] > 200.0)).tolist() == [True, True, False]
    assert frame["refusal"].notna().tolist() == [False, False, True]
    assert frame["refusal"][2] == "too-few-averages"
    assert repr(trend).startswith("Trend of 3 measurements, 1 of them refused\n  first ")
    assert f"{frame['preload_n'][0]:.4g} N" in repr(trend)
    [axes] = trend.plot().axes
    assert axes.lines[0].get_ydata().tolist() == frame["preload_n"][:2].tolist()
    assert axes.get_xlabel() == "days since 2026-03-03 00:00 UTC"
    uncalibrated = mc.Trend(replace(m, outcome=replace(m.outcome, preload=None)) for m in trend[:2])
    assert uncalibrated.plot().axes[0].get_ylabel() == "axial frequency [Hz]"
    assert repr(mc.Trend(trend[2:])) == "Trend of 1 measurements, 1 of them refused"
    assert mc.Trend(trend[2:]).plot().axes == []


def test_an_open_interval_is_drawn_to_where_it_is_known(figures: None) -> None:
    panel = Panel("", "x", "y", np.array([1.0]), np.array([300.0]), interval=(np.array([250.0]), np.array([np.inf])))

    class Open(Shown):
        def _panels(self) -> list[Panel]:
            return [panel]

    [axes] = Open().plot().axes
    assert axes.collections[0].get_segments()[0][:, 1].tolist() == [250.0, 300.0]


def test_an_explanation_says_what_was_found_in_some_lines(figures: None) -> None:
    found = FoundParameter(mc.Estimate(2.94e7, 1.2e6), "N/m", (2.7e7, 3.2e7), plausible=True)
    effect = FoundEffect("far-bearing-stiffness", "", "", {"stiffness": found}, ("second-mode",), 50.0, 20.0)
    x = np.arange(1.0, 5.0)
    panel = Panel("at 500 mm", "position [m]", "f [Hz]", x, 2 * x, {"after": 2.1 * x}, held_out=True)
    shown = replace(_NOTHING_ELSE, outcome=mc.Outcome.EQUIVALENT, effects=(effect,), panels=(panel,))
    assert repr(shown).splitlines()[1:] == [
        "  far-bearing-stiffness or second-mode", "    stiffness = 29400000 ± 1200000 N/m"
    ]  # fmt: skip
    assert shown.to_frame().loc[0, ["effect", "value", "upper_95"]].tolist() == [effect.key, 2.94e7, 3.2e7]
    [axes] = shown.plot(Figure()).axes
    assert axes.get_title() == "at 500 mm (held out)"
    assert axes.lines[1].get_ydata().tolist() == (2.1 * x).tolist()
    assert len(_NOTHING_ELSE.to_frame()) == 0
    assert "<svg" not in _NOTHING_ELSE._repr_html_()


def test_a_cell_shows_words_and_picture_and_without_matplotlib_words_alone(
    monkeypatch: pytest.MonkeyPatch, calibration: mc.Calibration
) -> None:
    cell = calibration._repr_html_()
    assert cell.startswith("<pre>Calibration of 12 readings")
    assert cell.count("<svg") == 1
    for library in ("matplotlib", "matplotlib.figure", "pandas"):
        monkeypatch.setitem(sys.modules, library, None)
    assert calibration._repr_html_() == cell[: cell.index("<svg")]
    with pytest.raises(MissingReaderError, match="a picture needs matplotlib; pip install matplotlib"):
        calibration.plot()
    with pytest.raises(MissingReaderError, match="a table needs pandas"):
        calibration.to_frame()
