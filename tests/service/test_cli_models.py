"""``preload modes`` and ``preload simulate``: drive models on the command line, and back through the product's road."""

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from monitor_core.effects import Form, Law, Variable, at_port, varying
from monitor_core.models.protocol import MotorEnd
from monitor_core.recordings.effect_file import effect_file_text
from monitor_core.recordings.model_file import read_model_file
from monitor_core.recordings.session_hdf5 import read_session
from tests.conftest import PROJECT_ROOT, canary
from tests.service.test_cli import assert_refused

MODELS = PROJECT_ROOT / "replay_data" / "models"
FAMILIES = ("lumped", "hybrid", "receptance", "transmission-line")


@pytest.fixture
def undamped(tmp_path: Path) -> Path:
    """Nguyen's axis without the damping that his paper does not state."""
    path = tmp_path / "undamped.toml"
    text = (MODELS / "lumped.toml").read_text(encoding="utf-8")
    path.write_text(text.replace("loss_factor = 0.03", ""), encoding="utf-8")
    return path


# --- modes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FAMILIES)
def test_modes_of_every_family(preload: Any, name: str) -> None:
    model = MODELS / f"{name}.toml"
    stated = ("--preload-n", "200") if name == "lumped" else ()
    document = preload("modes", model, "--position-mm", 200, 400, *stated, "--json").json()
    assert [place["position_mm"] for place in document["positions"]] == [200.0, 400.0]
    for place in document["positions"]:
        frequencies = [mode["frequency_hz"] for mode in place["modes"]]
        assert frequencies == sorted(frequencies)
        assert min(frequencies) > 0.0  # without the motion of the rigid drive
        assert all(0.0 <= mode["damping_ratio"] < 1.0 for mode in place["modes"])
    table = preload("modes", model, "--position-mm", 200, *stated).out
    assert "200.0 mm" in table
    assert f"{document['positions'][0]['modes'][0]['frequency_hz']:.3f} Hz" in table


def test_modes_go_with_the_position_of_a_second_axis(preload: Any) -> None:
    words = ("modes", MODELS / "cross-table.toml", "--position-mm", 600)
    stated = preload(*words, "--json").json()["positions"]
    places = preload(*words, "--second-position-mm", 300, 700, "--json").json()["positions"]
    assert [(place["position_mm"], place["second_position_mm"]) for place in places] == [(600.0, 300.0), (600.0, 700.0)]
    assert places[0]["modes"] == stated[0]["modes"]
    assert "second_position_mm" not in stated[0]
    of_axis = [place["modes"][1]["frequency_hz"] for place in places]
    assert of_axis[1] - of_axis[0] > 0.5
    table = preload(*words, "--second-position-mm", 700).out
    assert "600.0 and 700.0 mm" in table
    assert f"{of_axis[1]:.3f} Hz" in table
    assert_refused(
        preload("modes", MODELS / "receptance.toml", "--position-mm", 600, "--second-position-mm", 300),
        "a second axis at 0.3 m needs a model that states one",
    )


def test_modes_of_a_model_with_an_effect_of_ones_own(preload: Any, tmp_path: Path) -> None:
    """A bearing that is half as stiff at 400 mm as at 200 mm, as a law in a file, lowers the modes there alone."""
    law = varying("joints", "bearing_stiffness", Law(Variable.POSITION, Form.LINEAR, 0.2, 0.2), key="bearing-along")
    (tmp_path / "mine.py").write_text(effect_file_text([law]), encoding="utf-8")
    stated = (MODELS / "hybrid.toml").read_text(encoding="utf-8") + "\n[effects.bearing-along]\nchange = -0.5\n"
    (tmp_path / "mine.toml").write_text(stated, encoding="utf-8")
    words = ("--position-mm", 200, 400, "--motor-end", "free", "--json")
    assert_refused(preload("modes", tmp_path / "mine.toml", *words), "got 'bearing-along'")
    own = preload("modes", tmp_path / "mine.toml", "--effects", tmp_path / "mine.py", *words).json()["positions"]
    (tmp_path / "mine.toml").write_text(stated.replace("-0.5", "0.0"), encoding="utf-8")
    plain = preload("modes", tmp_path / "mine.toml", "--effects", tmp_path / "mine.py", *words).json()["positions"]
    first, elsewhere = [
        mine["modes"][0]["frequency_hz"] / theirs["modes"][0]["frequency_hz"]
        for mine, theirs in zip(own, plain, strict=True)
    ]
    assert first == pytest.approx(1.0, rel=1e-12)
    assert elsewhere < 0.95


def test_modes_of_a_screw_that_bends_are_listed_with_those_of_the_drive(preload: Any, tmp_path: Path) -> None:
    """The frequency of the bent screw is where a light bending leaves it; of five modes each adds one."""
    (tmp_path / "mine.py").write_text(effect_file_text([at_port("screw")]), encoding="utf-8")
    bends = "compliance_m_per_n = 1e-11\nfrequency_hz = 11.0\ndamping_ratio = 0.01\n"
    shares = "".join(f"share_{n} = {1.0 / n**2}\n" for n in range(2, 6))
    plain = (MODELS / "receptance.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(f'{plain}\n[effects."at-port:screw"]\n{bends}{shares}', encoding="utf-8")
    words = ("--position-mm", 400, "--json")
    of_drive = preload("modes", MODELS / "receptance.toml", *words).json()["positions"][0]["modes"]
    both = preload("modes", tmp_path / "mine.toml", "--effects", tmp_path / "mine.py", *words).json()["positions"][0]
    assert len(both["modes"]) == len(of_drive) + 5
    assert both["modes"][0]["frequency_hz"] == pytest.approx(11.0, rel=1e-3)
    assert both["modes"][0]["damping_ratio"] == pytest.approx(0.01, rel=1e-2)


def test_modes_of_suns_axis_fall_along_the_screw(preload: Any) -> None:
    """Recomputed from Sun et al. (2022), Table 1 without loss factor: 318.2 Hz at 0.05 m, 268.9 Hz at 0.70 m."""
    document = preload("modes", MODELS / "hybrid.toml", "--position-mm", 50, "--position-mm", 700, "--json").json()
    first = [place["modes"][0]["frequency_hz"] for place in document["positions"]]
    assert first == pytest.approx([318.2, 268.9], abs=0.4)  # the loss factor of the file adds up to 0.1 %


def test_modes_depend_on_motor_end_preload_and_payload(preload: Any) -> None:
    def first(*options: Any) -> float:
        words = ("modes", MODELS / "lumped.toml", "--position-mm", 500, "--preload-n", 200, *options, "--json")
        frequency = preload(*words).json()["positions"][0]["modes"][0]["frequency_hz"]
        assert isinstance(frequency, float)
        return frequency

    ends = {end: first("--motor-end", end) for end in MotorEnd}
    assert ends[MotorEnd.CLAMPED] < ends[MotorEnd.FREE] < ends[MotorEnd.PRESCRIBED]
    assert first() == ends[MotorEnd.CLAMPED]  # Nguyen's Eq. (6)
    assert first("--preload-n", 400) > first()
    table_mass = read_model_file(MODELS / "lumped.toml").parameters["table_mass_kg"] + 2.024 + 1.3  # Σm of Eq. (6)
    assert first("--payload-kg", 10) / first() == pytest.approx((table_mass / (table_mass + 10.0)) ** 0.5, rel=1e-3)


@pytest.mark.parametrize("words", [("--position-mm=300", 400), ("--position-mm", 300, "--position-mm=400")])
def test_numbers_after_an_equals_sign_were_an_unexpected_argument(preload: Any, words: tuple[Any, ...]) -> None:
    document = preload("modes", MODELS / "hybrid.toml", *words, "--json").json()
    assert [place["position_mm"] for place in document["positions"]] == [300.0, 400.0]


def test_the_transfer_matrix_is_written_drawn_and_printed(preload: Any, tmp_path: Path) -> None:
    """Zeros of Sun's axis without damping, recomputed from Table 1: 252.1 Hz of G11, 156.0 Hz of G22; none of G12."""
    words = ("modes", MODELS / "hybrid.toml", "--position-mm", 300, "--show", "matrix", "--band-hz", 20, 900)
    assert "296.85 Hz" in preload(*words, "--out", tmp_path / "g.csv").out
    with (tmp_path / "g.csv").open(encoding="utf-8") as stream:
        lines = np.loadtxt(stream, delimiter=",", skiprows=1)
    frequency, elements = lines[:, 0], lines[:, 1:].copy().view(complex)
    lowest = frequency[10:-10][np.argmin(np.abs(elements[10:-10]) * frequency[10:-10, None] ** 2, axis=0)]
    assert lowest[[0, 3]] == pytest.approx([252.1, 156.0], rel=0.02)  # the least with damping is not the zero itself
    np.testing.assert_allclose(elements[:, 1], elements[:, 2], rtol=1e-9)  # reciprocity
    document = preload(*words, "--json").json()
    printed = [complex(*pair) for pair in zip(*document["matrix_m_per_n"]["G22"].values(), strict=True)]
    modulus = np.interp(document["frequency_hz"], frequency, np.abs(elements[:, 3]))
    np.testing.assert_allclose(np.abs(printed), modulus, rtol=1e-3)
    preload(*words, "--out", tmp_path / "g.svg")
    drawn = PROJECT_ROOT / "docs" / "figures" / "transfer-matrix.svg"
    assert (tmp_path / "g.svg").read_text(encoding="utf-8") == drawn.read_text(encoding="utf-8")


def test_the_state_space_of_a_mat_file_answers_as_the_model_within_its_stated_error(
    preload: Any, tmp_path: Path
) -> None:
    words = ("modes", MODELS / "hybrid.toml", "--position-mm", 300, "--band-hz", 20, 900, "--show")
    preload(*words, "matrix", "--out", tmp_path / "g.csv")
    preload(*words, "state-space", "--out", tmp_path / "plant.mat")
    plant = scipy.io.loadmat(tmp_path / "plant.mat")
    with (tmp_path / "g.csv").open(encoding="utf-8") as stream:
        lines = np.loadtxt(stream, delimiter=",", skiprows=1)
    exact = lines[:, 1:].copy().view(complex).reshape(-1, 2, 2)
    s = 2j * np.pi * lines[:, 0, None, None]
    reduced = plant["C"] @ np.linalg.inv(s * np.eye(4) - plant["A"]) @ plant["B"] + plant["D"]
    apart = np.linalg.svd(exact - reduced)[1][:, 0] / np.linalg.svd(exact)[1][:, 0]
    assert plant["largest_relative_error"].item() == pytest.approx(apart.max(), rel=1e-6)
    assert apart.max() < 0.03
    document = preload(*words, "state-space", "--json", "--modes", 1).json()
    assert (len(document["A"]), document["largest_relative_error"] > 0.5) == (2, True)  # not over the elastic mode
    assert "2.8 %" in preload(*words, "state-space").out


def test_laws_of_fig_7_with_range_and_residual(preload: Any) -> None:
    """Residuals recomputed from Table 1 without loss factor: 0.076 Hz along the screw; 0.025, 0.24, 2.3 Hz by mass."""
    words = ("modes", MODELS / "hybrid.toml", "--show", "laws", "--position-mm", 300)
    along, by_mass = preload(*words, 50, 700, "--payload-kg", 10, "--json").json()["laws"]
    assert (along["range"], len(along["coefficients_hz"])) == ([0.05, 0.7], 3)
    assert along["largest_residual_hz"] == pytest.approx(0.076, abs=0.001)
    assert np.polyval(along["coefficients_hz"][::-1], [0.05, 0.7]) == pytest.approx([318.2, 268.9], abs=0.4)
    assert by_mass["largest_residual_hz"] == pytest.approx(0.025, abs=0.003)
    for payload, residual in ((20, 0.24), (50, 2.3)):
        (law,) = preload(*words, "--payload-kg", payload, "--json").json()["laws"]
        assert law["largest_residual_hz"] == pytest.approx(residual, rel=0.15)
    assert "0.05 to 0.7 m" in preload(*words, 50, 700).out


@pytest.mark.parametrize(
    ("model", "words", "complaint"),
    [
        ("receptance", ("--show", "matrix"), "of the family hybrid"),
        ("hybrid", ("--show", "matrix", "--motor-end", "clamped"), "with a free motor end"),
        ("hybrid", ("--show", "matrix", "--band-hz", 900, 20), "LOW before HIGH"),
        ("hybrid", ("--show", "state-space", "--modes", 3), "must be 1 to 2"),
        ("hybrid", ("--show", "laws"), "two positions or more"),
        ("hybrid", ("--out", "g.csv"), "--out goes with --show"),
        ("hybrid", ("--show", "laws", "--second-position-mm", 100), "--second-position-mm goes with --show modes"),
    ],
)
def test_what_a_drive_cannot_show_is_refused(preload: Any, model: str, words: tuple[Any, ...], complaint: str) -> None:
    assert_refused(preload("modes", MODELS / f"{model}.toml", "--position-mm", 300, *words), complaint)


def stating(name: str, folder: Path, simulation: str) -> Path:
    """Write a bundled model with tables of a simulation."""
    path = folder / "stated.toml"
    path.write_text((MODELS / f"{name}.toml").read_text(encoding="utf-8") + "\n" + simulation, encoding="utf-8")
    return path


# --- simulate --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", canary(FAMILIES))
def test_a_simulated_session_goes_the_whole_road(preload: Any, tmp_path: Path, name: str) -> None:
    model = MODELS / f"{name}.toml"
    out = tmp_path / "out.session.h5"
    stated = ("--preload-n", "200") if name == "lumped" else ()
    simulated = preload("simulate", model, "--out", out, *stated, "--json").json()
    assert simulated["windows"] == 45
    assert preload("check", out, "--json").json()["valid"] is True
    found = preload("frf", out, "--json").json()["measurements"]
    for item, truth in zip(found, simulated["measurements"], strict=True):
        assert item["measurement"] == truth["measurement"]
        assert item["windows_refused"] == {}
        assert item["coherence"] > 0.8  # below, the product warns
        deviation = item["frequency_hz"] - truth["model_frequency_hz"]
        assert abs(deviation) < 3.0 * item["frequency_standard_uncertainty_hz"]
        assert item["position_mm"] == pytest.approx(truth["position_mm"])


@pytest.mark.release
def test_calibrate_on_a_simulated_session(preload: Any, tmp_path: Path) -> None:
    """Eq. (8) of Nguyen et al. holds exactly for his model, so that the preloads of a second session come back."""
    session, other = tmp_path / "calibration.session.h5", tmp_path / "other.session.h5"
    calibration = tmp_path / "calibration.json"
    places = ("--position-mm", 200, 500, 800)
    preload("simulate", MODELS / "lumped.toml", "--out", session, *places, "--preload-n", 100, 200, 350)
    document = preload("calibrate", session, "--out", calibration, "--json").json()
    assert document["n_readings"] == 9
    assert document["residual_max_hz"] < 0.02
    preload("simulate", MODELS / "lumped.toml", "--out", other, *places, "--preload-n", 150, 300, "--seed", 3)
    estimates = preload("estimate", other, "--calibration", calibration, "--json").json()["estimates"]
    for estimate, truth in zip(estimates, np.repeat([150.0, 300.0], 3), strict=True):
        low, high = estimate["interval_95_n"]
        assert low < truth < high
        assert estimate["preload_n"] == pytest.approx(truth, rel=0.02)


def test_the_same_seed_gives_the_same_file(preload: Any, tmp_path: Path) -> None:
    files = []
    for name, seed in (("a.h5", 5), ("b.h5", 5), ("c.h5", 6)):
        words = ("simulate", MODELS / "hybrid.toml", "--out", tmp_path / name, "--windows", 2, "--seed", seed)
        assert preload(*words).exit_code == 0
        files.append((tmp_path / name).read_bytes())
    assert files[0] == files[1]
    assert files[0] != files[2]


def test_simulate_does_what_its_options_say(preload: Any, tmp_path: Path) -> None:
    out = tmp_path / "out.h5"
    recording = "[simulation.recording]\nsample_rate_hz = 2048\ntorque_noise_nm = 0\nacceleration_noise_m_per_s2 = 0\n"
    words = (
        "simulate", stating("lumped", tmp_path, recording + "[simulation.friction-at-guides]\ncoulomb_n = 8\n"),
        "--out", out, "--position-mm", 300, 600, "--preload-n", 150, 250, "--payload-kg", 4,
        "--windows", 3, "--seconds", 0.5, "--excitation-source", "drive",
    )  # fmt: skip
    answer = preload(*words)
    assert answer.exit_code == 0
    assert "12 windows in out.h5" in answer.out
    session = read_session(out)
    assert len(session.measurements) == 4
    settings = {(w.conditions.position, w.conditions.preload, w.conditions.payload_mass) for w in session.windows}
    assert settings == {(0.3, 150.0, 4.0), (0.6, 150.0, 4.0), (0.3, 250.0, 4.0), (0.6, 250.0, 4.0)}
    first = session.windows[0]
    assert (first.n_samples, first.sample_rate, str(first.excitation_source)) == (1024, 2048.0, "drive")
    assert session.axis_id == "stated"
    stating("lumped", tmp_path, recording)
    quiet = preload(*words, "--force", "--json").json()
    assert quiet["windows"] == 12
    drag = np.abs(first.excitation).max() - np.abs(read_session(out).windows[0].excitation).max()
    assert drag != 0.0


# --- refusals --------------------------------------------------------------------------------------------------------


def test_a_bad_model_is_one_line(preload: Any, tmp_path: Path, subtests: pytest.Subtests) -> None:
    for command, (text, words) in itertools.product(
        ["modes", "simulate"],
        [
            ("family = ", "expected a drive model in TOML"),
            (
                'family = "spring"\n[parameters]\n',
                "family must be one of lumped, hybrid, receptance, transmission-line",
            ),
            ('family = "hybrid"\n[parameters]\n', "a hybrid model needs table_mass_kg"),
            ('family = "hybrid"\n[parameters]\ntable_mass_kg = true\n', "expected a number [SI]; got bool True"),
            ('family = "hybrid"\n[motor]\n', "got 'motor'"),
            (
                (MODELS / "hybrid.toml").read_text(encoding="utf-8") + "[effects.heavier]\nmass_kg = 1\n",
                "the key of an effect must be one of",
            ),
        ],
    ):
        with subtests.test(command=command, text=text):
            bad, out = tmp_path / "bad.toml", tmp_path / "out.h5"
            bad.write_text(text, encoding="utf-8")
            more = ("--position-mm", 300) if command == "modes" else ("--out", out)
            assert_refused(preload(command, bad, *more), words)
            assert not out.exists()


def test_bad_input_is_one_line(
    preload: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    for words, complaint in [
        (("modes", "lumped.toml"), "--position-mm"),
        (("modes", "lumped.toml", "--position-mm", 500), "state the preload"),
        (("modes", "lumped.toml", "--position-mm", 500, "--preload-n", 500), "must not exceed 10 %"),
        (("modes", "lumped.toml", "--position-mm", 500, "--preload-n", -5), "preload must be positive; got -5.0 N"),
        (("modes", "hybrid.toml", "--position-mm", 900), "position must lie on the screw, within 0 and 0.7465 m"),
        (("modes", "hybrid.toml", "--position-mm", 300, "--motor-end", "loose"), "loose"),
        (("modes", "hybrid.toml", "--position-mm", "here"), "'here'"),
        (("modes", "hybrid.toml", "--position-mm", 300, "--payload-kg", -1), "payload_mass must not be negative"),
        (("modes", "none.toml", "--position-mm", 300), "none.toml: expected a file; nothing is"),
        (("simulate", "hybrid.toml"), "--out"),
        (("simulate", "hybrid.toml", "--out", "x.csv"), "a session file ends in .h5 or .hdf5; got x.csv"),
        (("simulate", "hybrid.toml", "--out", "x.h5", "--windows", 0), "--windows"),
        (("simulate", "hybrid.toml", "--out", "x.h5", "--seconds", 0), "window_duration must be positive; got 0.0 s"),
        (("simulate", "hybrid.toml", "--out", "x.h5", "--seconds", 0.1), "a move takes up to 0.069 s"),
        (("simulate", "hybrid.toml", "--out", "x.h5", "--seconds", 1e12), "must not exceed 16,777,216 samples"),
        (("simulate", "hybrid.toml", "--out", "x.h5", "--windows", 10**9), "must not exceed 16,777,216 samples"),
        (("simulate", "hybrid.toml", "--out", "x.h5", "--channels", "x.csv"), "--channels goes with --motion"),
        (("simulate", "hybrid.toml", "--out", "x.h5", "--motion", "to-and-fro.csv"), "of the family transmission-line"),
        (
            ("simulate", "transmission-line.toml", "--out", "x.h5", "--motion", "to-and-fro.csv"),
            "[simulation.speed-loop]",
        ),
        (("simulate", "speed-loop.toml", "--out", "x.h5", "--motion", "speed-loop.toml"), "speed-loop.toml"),
        (("simulate", "none.toml", "--out", "nodir/x.h5"), "cannot write x.h5: folder nodir does not exist"),
        (("simulate", "hybrid.toml", "--out", "x.h5", "--preload-n", 100), "state the rating"),
        (("simulate", "hybrid.toml", "--out", "x.h5", "--position-mm", 0), "position must lie on the screw"),
    ]:
        with subtests.test(words=words, complaint=complaint):
            monkeypatch.chdir(tmp_path)
            for name in ("lumped.toml", "hybrid.toml", "transmission-line.toml", "speed-loop.toml", "to-and-fro.csv"):
                (tmp_path / name).write_bytes((MODELS / name).read_bytes())
            assert_refused(preload(*words), complaint)
            assert not (tmp_path / "x.h5").exists()


@pytest.mark.parametrize(
    ("simulation", "complaint"),
    [
        ("[simulation.recording]\nsample_rate_hz = 500", "sample_rate of at least 1333.33 Hz"),
        ("[simulation.recording]\nsample_rate_hz = 1e9", "must not exceed 16,777,216 samples"),
        ("[simulation.recording]\ntorque_noise_nm = 1e300", "must fit into single precision"),
        ("[simulation.recording]\nrate = 1", "recording has the entries sample_rate_hz, "),
        ("[simulation.friction-at-guides]\ncoulomb_n = -1", "coulomb friction must not be negative"),
        ("[simulation.friction-at-guides]\ncoulomb_n = 1e6", "must not exceed the 508.3 N"),
        ("[simulation.friction-at-nut]\nstatic_nm = 1", "; without coulomb_nm"),
        ("[simulation.friction-at-chuck]\ncoulomb_nm = 1", "got 'friction-at-chuck'"),
        ("[simulation.speed-loop]\nintegral_time_s = 1", "; without current_lag_s"),
    ],
)
def test_a_simulation_that_cannot_be_is_one_line(preload: Any, tmp_path: Path, simulation: str, complaint: str) -> None:
    model = stating("hybrid", tmp_path, simulation)
    assert_refused(preload("simulate", model, "--out", tmp_path / "x.h5"), complaint)
    assert not (tmp_path / "x.h5").exists()


def test_a_motion_is_followed_in_the_loop_and_its_session_shows_the_axis(preload: Any, tmp_path: Path) -> None:
    """By the drive's torque with the commanded speed as its reference, in windows without pause."""
    out, motion = tmp_path / "out.session.h5", tmp_path / "motion.csv"
    times = np.arange(0.0, 12.01, 0.05)
    rows = [f"{t:.2f},{0.012 * np.sin(np.pi * t):.6f},{500.0 * (t > 3.0):g}" for t in times.tolist()]
    motion.write_text("\n".join(["time_s,speed_m_per_s,cutting_force_n", *rows]), encoding="utf-8")
    words = ("simulate", MODELS / "speed-loop.toml", "--motion", motion, "--position-mm", 400)
    words += ("--excitation-source", "drive", "--out", out, "--force")
    truth = preload(*words, "--channels", tmp_path / "c.csv", "--json").json()
    assert truth["windows"] == 11
    assert preload("check", out, "--json").json()["valid"] is True
    (found,) = preload("frf", out, "--band-hz", 100, 200, "--json").json()["measurements"]
    deviation = found["frequency_hz"] - truth["measurements"][0]["model_frequency_hz"]
    assert abs(deviation) < 3.0 * found["frequency_standard_uncertainty_hz"] + 0.1  # and some for 4 mm farther
    first, second = read_session(out).windows[:2]
    assert str(first.source) == "drive-by-reference"
    assert (second.started_at - first.ended_at).total_seconds() == 0.0
    with (tmp_path / "c.csv").open(encoding="utf-8") as stream:
        names = stream.readline().strip().split(",")
        channels = dict(zip(names, np.loadtxt(stream, delimiter=",").T, strict=True))
    late = channels["time_s"] > 4.0
    mounted = channels["bearing_force_n"] + channels["far_bearing_force_n"]
    # of Newton's law, over whole periods: what the mountings hold is the cutting force and the friction, no more
    assert np.mean(mounted[late]) == pytest.approx(500.0, abs=30.0)
    assert np.ptp(channels["travel_m"]) == pytest.approx(0.0076, abs=0.001)
    preload(*words, "--channels", tmp_path / "c.svg")
    assert (tmp_path / "c.svg").read_text(encoding="utf-8").startswith("<svg")
    assert_refused(preload(*words, "--windows", 2), "--windows goes without --motion")
    kept = preload(*words[:-2], tmp_path / "new.session.h5", "--channels", tmp_path / "c.csv")
    assert_refused(kept, "c.csv already exists; --force replaces it")


def test_a_model_without_damping_is_told_so(preload: Any, undamped: Path, tmp_path: Path) -> None:
    for model, said in ((undamped, True), (MODELS / "lumped.toml", False)):
        words = (
            "simulate",
            model,
            "--out",
            tmp_path / "out.h5",
            "--force",
            "--preload-n",
            200,
            "--windows",
            2,
            "--json",
        )
        answer = preload(*words)
        assert answer.json()["windows"] == 6
        assert ("states no damping" in answer.err) == said


def test_a_file_that_is_there_is_kept_unless_forced(preload: Any, tmp_path: Path) -> None:
    out = tmp_path / "out.h5"
    out.write_text("precious")
    words = ("simulate", MODELS / "hybrid.toml", "--out", out, "--windows", 2, "--position-mm", 300)
    assert_refused(preload(*words), "already exists; --force replaces it")
    assert out.read_text() == "precious"
    assert preload(*words, "--force").exit_code == 0
    assert len(read_session(out).windows) == 2


def test_check_tells_a_drive_model(preload: Any, tmp_path: Path) -> None:
    for name in FAMILIES:
        report = preload("check", MODELS / f"{name}.toml", "--json").json()
        assert [report[key] for key in ("format", "valid", "problems")] == ["preload-model", True, []]
        assert report["usable_by"] == ["modes", "simulate", "identify", "explain"]
    bad = tmp_path / "bad.toml"
    bad.write_text('family = "hybrid"\n[parameters]\n')
    answer = preload("check", bad, "--json")
    assert answer.exit_code == 2
    assert "needs table_mass_kg" in json.loads(answer.out)["problems"][0]


def test_help_of_both(preload: Any) -> None:
    for command in ("modes", "simulate"):
        answer = preload(command, "--help")
        assert (answer.exit_code, answer.err) == (0, "")
        assert "--position-mm X…" in answer.out
    assert "the rigid drive (0 Hz) is left out" in " ".join(preload("modes", "--help").out.split())
