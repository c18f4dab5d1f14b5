"""Recordings of others end in their known answers through the command line alone; what cannot, says why."""

from pathlib import Path

import pytest

from monitor_core.recordings import read_motion_record


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    """Run commands in a folder of their own."""
    monkeypatch.chdir(tmp_path)


def answer_of(run, *words):
    return run(*words, "--json").json()


def refused(run, *words):
    code, out, err = run(*words)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1, err
    return err


def write(name, text):
    Path(name).write_text(text, encoding="utf-8")
    return name


EMPS = """\
time = {channel = "t", unit = "s"}
[motion]
position = {channel = "qm", unit = "m"}
force = {channel = "vir", unit = "V", sensitivity = 35.15065, sensitivity_unit = "N/V"}
reference = {channel = "qg", unit = "m"}
"""
#: Where an identification starts: the moving mass and viscous friction of the benchmark are left to the fit.
EMPS_AXIS = """\
family = "motion"
[parameters]
moving_mass_kg = 100.0
viscous_friction_ns_per_m = 200.0
[uncertain]
moving_mass_kg = 0.5
viscous_friction_ns_per_m = 0.5
"""


@pytest.fixture
def emps(measured_data):
    return measured_data / "emps" / "DATA_EMPS.mat"


def test_a_ball_screw_axis_becomes_a_motion_record(preload, emps):
    answer = answer_of(preload, "import", emps, "--map", write("emps.toml", EMPS), "--out", "emps.csv")
    assert (answer["written"], answer["samples"], answer["left_out"]) == ("emps.csv", 24_841, [])
    record = read_motion_record(Path("emps.csv"))
    assert record.sample_rate == pytest.approx(1000.0, rel=1e-4)
    # the benchmark's first sample: 2.538 628 09 V at 35.150 65 N/V
    assert record.drive[0] == pytest.approx(2.53862809 * 35.15065, rel=1e-8)


@pytest.mark.release
def test_the_motion_of_the_axis_lacks_coulomb_friction_first(preload, emps):
    # The benchmark: M 95.12 kg, Fv 203.5 N s/m, Fc 20.39 N; the ladder's first step is Coulomb friction, 17.9 % to 7 %.
    answer = answer_of(
        preload, "explain", emps, "--map", write("emps.toml", EMPS), "--baseline", write("axis.toml", EMPS_AXIS)
    )
    # The offset of the benchmark is really a friction that differs with the direction, so either says it.
    effects = {effect["key"]: effect for effect in answer["effects"]}
    friction = {"coulomb-friction", "direction-dependent-friction", "stribeck-friction"}
    assert friction & set(effects)
    assert answer["gap"]["before"]["held_out"] == pytest.approx(17.9, abs=1.5)  # [%]
    assert answer["gap"]["after"]["held_out"] < 4.5


HAMMER = """\
axis_id = "structure"
excitation = {channel = "array", row = 2, quantity = "force", source = "sensor", unit = "N"}
response = {channel = "array", row = 3, unit = "m/s2"}
time = {channel = "array", row = 1, unit = "s"}
[window]
measurement = "hits"
started_at = 2024-01-01T00:00:00Z
file_interval_s = 60
position_mm = 0
position_span_mm = 0
"""


@pytest.fixture
def hits(measured_data):
    return [measured_data / "pyfrf_impacts" / f"measurements_{number}.npy" for number in range(1, 6)]


@pytest.mark.release
def test_five_hammer_hits_show_their_four_modes_in_one_command(preload, hits):
    answer = answer_of(preload, "frf", *hits, "--map", write("hits.toml", HAMMER), "--band-hz", 500, 4140, "--modes", 6)
    (measurement,) = answer["measurements"]
    found = [mode["frequency_hz"] for mode in measurement["modes"] if not mode["refused"]]
    for frequency in (900.0, 2640.0, 3669.0, 4128.0):
        # Half a line of 1 Hz: what the peak bin promises.
        assert min(abs(mode - frequency) for mode in found) <= 0.5, (frequency, found)


def test_a_session_of_the_hits_answers_band_by_band(preload, hits):
    code, _, err = preload("import", *hits, "--map", write("hits.toml", HAMMER), "--out", "hits.session.h5")
    assert code == 0, err
    assert "in the order given" in err
    answer = answer_of(preload, "frf", "hits.session.h5", "--band-hz", 800, 1000)
    assert answer["measurements"][0]["frequency_hz"] == pytest.approx(900.0, abs=0.5)


def test_one_hit_is_not_judged(preload, hits):
    answer = answer_of(preload, "frf", hits[0], "--map", write("hits.toml", HAMMER), "--band-hz", 800, 1000)
    assert answer["measurements"][0]["reason"] == "too-few-averages"


TOOL = """\
[frf]
input = "force-at-table"
output = "displacement-at-table"
frequency = {channel = "1", unit = "Hz"}
real = {channel = "2", unit = "m/N"}
imaginary = {channel = "3", unit = "m/N"}
relative = 0.01
[window]
position_mm = 0
"""


@pytest.mark.release
def test_five_receptances_of_a_tool_become_an_frf_set_with_its_three_modes(preload, measured_data):
    files = [measured_data / "tool_frf" / f"Point_{number}_Channel_1_CH1.txt" for number in range(1, 6)]
    answer = answer_of(preload, "import", *files, "--map", write("tool.toml", TOOL), "--out", "tool.frf.h5")
    assert answer["conditions"] == 5
    assert [left["what"] for left in answer["left_out"]] == [f"1 of 5001 lines of {path.name}" for path in files]
    answer = answer_of(preload, "frf", "tool.frf.h5", "--band-hz", 600, 3500, "--modes", 4)
    (tool,) = answer["responses"]
    modes = {mode["frequency_hz"]: mode["damping_ratio"] for mode in tool["modes"]}
    for frequency, damping in ((1072.2, 0.033), (1978.5, 0.056), (2614.8, 0.047)):
        nearest = min(modes, key=lambda found: abs(found - frequency))
        assert nearest == pytest.approx(frequency, rel=0.01)  # what its publication and the fit of others differ by
        assert modes[nearest] == pytest.approx(damping, rel=0.2)
    # A sum of three modes leaves 17 %, of four, with a shoulder near 1247 Hz, 9.4 %.
    assert min(abs(found - 1247.0) for found in modes) < 25.0
    assert tool["unexplained"] == pytest.approx(0.094, abs=0.02)


def test_one_hit_on_the_tool_is_refused(preload, measured_data):
    hit = measured_data / "tool_frf" / "Impact_Point1_Channel1_CH1.txt"
    text = HAMMER.replace('"array", row = 2', '"2"').replace('"array", row = 3', '"3"')
    text = text.replace('"array", row = 1', '"1"')
    answer = answer_of(preload, "frf", hit, "--map", write("hit.toml", text))
    assert answer["measurements"][0]["reason"] == "too-few-averages"


def test_records_without_an_excitation_are_refused_for_that(preload, measured_data):
    record = measured_data / "dropbear" / "slow10_test0.txt"
    text = 'axis_id = "beam"\nresponse = {channel = "1", unit = "g"}\n[window]\nsample_rate_hz = 5000\n'
    sentence = refused(preload, "frf", record, "--map", write("beam.toml", text))
    assert "expected a table [excitation] with channel, quantity, source" in sentence


def test_shocks_whose_excitation_is_an_acceleration_are_refused_for_that(preload, measured_data):
    shocks = measured_data / "pcb_shock" / "pcb_shock.npz"
    text = HAMMER.replace('"array", row = 2', '"X"').replace('unit = "N"', 'unit = "m/s2"')
    sentence = refused(preload, "frf", shocks, "--map", write("board.toml", text))
    assert "expected a unit of force" in sentence
    assert "got 'm/s2', a unit of acceleration" in sentence


def test_a_record_of_wear_without_vibration_is_refused_for_that(preload, measured_data):
    wear = measured_data / "xjtu_ballscrew" / "Up_FT.txt"
    text = (
        'axis_id = "screw"\nexcitation = {channel = "1", quantity = "torque", source = "drive", unit = "N.m"}\n'
        'response = {channel = "1", unit = "m/s2"}\n[window]\nsample_rate_hz = 7.9365e-6\n'
        "started_at = 2024-01-01T00:00:00Z\nposition_mm = 0\nposition_span_mm = 0\n"
    )
    sentence = refused(preload, "frf", wear, "--map", write("wear.toml", text))
    assert "it holds no vibration of an axis" in sentence


BENCH = """\
axis_id = "bench"
excitation = {channel = "EXCITATION", quantity = "force", source = "sensor", unit = "V", sensitivity = 10, \
sensitivity_unit = "mV/N"}
response = {channel = "RESPONSE", unit = "UNIT"}
[window]
position_mm = 0
position_span_mm = 0
samples_per_window = 900
"""


def test_a_file_of_a_daqmx_task_becomes_windows_and_the_rest_is_left_out(preload, measured_data):
    pytest.importorskip("nptdms")
    path = measured_data / "readers" / "tdms" / "raw1.tdms"
    text = BENCH.replace("EXCITATION", "Layer Data/First  Channel").replace("RESPONSE", "Layer Data/Second Chan")
    text = text.replace('"UNIT"', '"V", sensitivity = 100, sensitivity_unit = "mV/g"')
    answer = answer_of(preload, "import", path, "--map", write("bench.toml", text), "--out", "bench.session.h5")
    assert answer["windows"] == 2
    assert [left["what"] for left in answer["left_out"]] == ["the last 200 of 2000 samples of raw1.tdms (0.004 s)"]
    assert answer_of(preload, "check", "bench.session.h5")["valid"]


def test_accelerations_of_a_universal_file_are_no_force(preload, measured_data):
    pytest.importorskip("pyuff")
    path = measured_data / "readers" / "uff" / "MPSTD#Set001_2024_10_08_10_27_07.uff"
    text = BENCH.replace("EXCITATION", "MPS set1 Dof1").replace("RESPONSE", "MPS set1 Dof2").replace("UNIT", "m/s2")
    sentence = refused(preload, "frf", path, "--map", write("bench.toml", text))
    assert "expected 'V' as the map says; the file says 'm/s2'" in sentence


def test_the_published_frequencies_give_the_coefficients_of_the_paper(preload, published_data):
    answer = answer_of(preload, "calibrate", published_data / "nguyen_table2.csv", "--weighting", "none")
    assert answer["residual_rms_hz"] == pytest.approx(0.2215, abs=5e-4)


@pytest.mark.parametrize("name", ["nguyen_table1.csv", "tian_measured.csv", "moreno_constants.csv"])
def test_a_table_of_constants_is_refused_by_what_it_lacks(preload, published_data, name):
    path = published_data / name
    if not path.is_file():
        pytest.skip(f"no {name} here")
    assert "position_mm" in refused(preload, "calibrate", path)


def test_a_response_of_a_universal_file_becomes_an_frf_set(preload, measured_data):
    pytest.importorskip("pyuff")
    path = measured_data / "readers" / "uff" / "measurement.uff"
    text = (
        TOOL.partition("frequency =")[0].replace("displacement", "acceleration")
        + 'response = {channel = "1", unit = "m/(N.s2)"}\nrelative = 0.01\n'
    )
    words = ("--map", write("beam.toml", text + "[window]\nposition_mm = 0\n"))
    answer = answer_of(preload, "import", path, *words, "--out", "beam.frf.h5")
    assert (answer["conditions"], answer["left_out"][0]["what"]) == (1, "1 of 1001 lines of measurement.uff")
    modes = answer_of(preload, "frf", "beam.frf.h5", "--band-hz", 20, 600)["responses"][0]["modes"]
    assert modes == answer_of(preload, "frf", path, *words, "--band-hz", 20, 600)["responses"][0]["modes"]


F16_MAP = """\
axis_id = "f16"
[text]
separator = "comma"
header_row = 1
[excitation]
channel = "Force"
quantity = "force"
source = "sensor"
unit = "N"
[response]
channel = "Acceleration2"
unit = "m/s2"
[window]
sample_rate_hz = 400
samples_per_window = 8192
started_at = 2014-09-15T06:00:00Z
file_interval_s = 600
position_mm = 0
position_span_mm = 0
"""
#: Of the wing torsion at each of seven levels: the ends as they are known of this benchmark, those between by rational
#: fits of several widths to the lines of the eight steady periods [Hz].
F16_TORSION = (7.318, 7.285, 7.261, 7.231, 7.209, 7.185, 7.160)


@pytest.mark.release
def test_a_wing_at_seven_levels_has_its_frequencies_and_is_said_to_soften(measured_data, preload):
    # J. P. Noël, M. Schoukens, F-16 aircraft benchmark based on ground vibration test data, 2017: nine periods a file,
    # the first of them a transient, lines from 2 to 15 Hz with ten modes, 8192 samples a period
    files = sorted(str(path) for path in (measured_data / "f16_gvt").glob("F16Data_FullMSine_Level*.csv"))
    if len(files) != len(F16_TORSION):
        pytest.skip(f"no files of the F-16 benchmark in {measured_data / 'f16_gvt'}")
    answered = answer_of(preload, "frf", *files, "--map", write("f16.toml", F16_MAP), "--band-hz", "6.8", "7.8")
    for truth, measured in zip(F16_TORSION, answered["measurements"], strict=True):
        frequency, uncertainty = measured["frequency_hz"], measured["frequency_standard_uncertainty_hz"]
        assert frequency == pytest.approx(truth, rel=1.5e-3)
        assert abs(frequency - truth) < 1.96 * uncertainty < 4e-3 * truth
    softer = [m["measurement"] for m in answered["measurements"] if "falls with the level" in " ".join(m["warnings"])]
    assert softer[0].endswith("Level1")
    assert softer[-1].endswith("Level7")
