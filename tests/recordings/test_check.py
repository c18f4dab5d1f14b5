"""``check_file``: every format is recognised by its content, and every problem is a sentence."""

from datetime import UTC, datetime, timedelta

import h5py
import numpy as np
import pytest
import scipy.io

from monitor_core.recording import Conditions, Session, Window
from monitor_core.recordings import check_file, write_session
from tests.conftest import PROJECT_ROOT

MAP = (
    'axis_id = "x"\n[excitation]\nchannel = "f"\nquantity = "force"\nsource = "sensor"\nunit = "N"\n[response]\n'
    'channel = "a"\nunit = "g"\n[window]\nposition_mm = 1\nposition_span_mm = 0\n'
)
MODELS = PROJECT_ROOT / "replay_data" / "models"
TEXTS = {
    "table.csv": ("modal-table", "position_mm,frequency_hz\n250,189\n"),
    "samples.csv": ("csv", "t,force\n0,1\n1,2\n"),
    "samples.txt": ("csv", "0.0 1.0\n1.0 2.0\n"),
    "map.toml": ("channel-map", MAP),
    "model.toml": ("preload-model", (MODELS / "lumped.toml").read_text(encoding="utf-8")),
}


def verdict(path):
    report = check_file(path)
    return report.format, report.valid, report.problems


@pytest.mark.parametrize("name", TEXTS)
def test_good_texts_are_recognised(tmp_path, name):
    expected, text = TEXTS[name]
    (tmp_path / name).write_text(text)
    assert verdict(tmp_path / name) == (expected, True, ())


def test_good_raw_files_are_recognised_whatever_their_ending(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.ones(3))
    scipy.io.savemat(tmp_path / "a.mat", {"x": np.ones(3)})
    scipy.io.savemat(tmp_path / "b.mat", {"x": np.ones(3)}, format="4")
    (tmp_path / "a.npz").rename(tmp_path / "a.dat")
    assert [check_file(tmp_path / n).format for n in ("a.dat", "a.mat", "b.mat")] == ["npz", "mat", "mat"]
    assert all(check_file(tmp_path / n).valid for n in ("a.dat", "a.mat", "b.mat"))


def session_of(path, n_windows):
    start = datetime(2025, 3, 1, tzinfo=UTC)
    windows = (
        Window(np.ones(8), np.ones(8), 1e3, start + timedelta(seconds=i), Conditions(0.1), "a")
        for i in range(n_windows)
    )
    write_session(path, Session("x", tuple(windows)))


def test_every_bad_window_of_a_session_is_listed(tmp_path):
    path = tmp_path / "a.session.h5"
    session_of(path, 3)
    assert verdict(path) == ("preload-session", True, ())
    with h5py.File(path, "r+") as file:
        file["windows/000000"].attrs["response_unit"] = "g"
        del file["windows/000002/response"]
    report = check_file(path)
    assert not report.valid
    assert len(report.problems) == 2
    assert "/windows/000000, response_unit: expected 'm/s2'; got 'g'" in report.problems[0]
    assert "/windows/000002/response: expected a dataset; it is missing" in report.problems[1]


def test_the_list_of_problems_is_bounded(tmp_path):
    path = tmp_path / "a.session.h5"
    session_of(path, 30)
    with h5py.File(path, "r+") as file:
        for group in file["windows"].values():
            group.attrs["response_unit"] = "g"
    problems = check_file(path).problems
    assert len(problems) == 21
    assert problems[-1] == "a.session.h5: further problems are not listed"


BAD = {
    "nothing.csv": (None, "unknown", "nothing is at this path"),
    "empty.csv": (b"", "unknown", "the file is empty (0 bytes)"),
    "noise.bin": (b"\x00\xff\xfe\x80", "unknown", "neither text nor any of them (it begins with 00 ff fe 80)"),
    "table.csv": (b"position_mm,frequency\n1,2\n", "modal-table", "expected the column 'frequency_hz'"),
    "cut.tdms": (b"TDSm\x0e\x00", "tdms", "expected a TDMS segment at byte 0"),
    "cut.npz": (b"PK\x03\x04", "npz", "expected a NumPy archive"),
    "cut.mat": (b"MATLAB 5.0 MAT-file", "mat", "expected a MATLAB file"),
    "cut.uff": (b"    -1\n    58\n", "uff58", "the file is cut off"),
    "cut.h5": (b"\x89HDF\r\n\x1a\n", "preload-session", "expected an HDF5 file"),
    "bad.json": (b"{", "preload-calibration", "bad.json"),
    "family.toml": (b'family = "spring"\n[parameters]\n', "preload-model", "family must be one of lumped, hybrid"),
    "quoted.toml": (b"'family' = 1\n", "preload-model", "family: expected a text; got int 1"),
    "cut.toml": (b'family = "lumped"\n[param', "preload-model", "expected a drive model in TOML"),
    "nameless.toml": (b"[parameters]\ntable_mass_kg = 1\n", "preload-model", "family: expected a text; it is missing"),
    "bad.toml": (b"axis_id = 3\n", "channel-map", "expected a table [excitation]"),
}


def test_a_bad_file_gets_one_sentence(tmp_path, subtests):
    for name, (content, expected, sentence) in BAD.items():
        with subtests.test(name=name):
            if content is not None:
                (tmp_path / name).write_bytes(content)
            report = check_file(tmp_path / name)
            assert (report.format, report.valid, len(report.problems)) == (expected, False, 1)
            assert sentence in report.problems[0]


def test_an_frf_set_is_known_by_name(tmp_path):
    with h5py.File(tmp_path / "a.frf.h5", "w") as file:
        file.attrs["format"] = "preload-frf-set"
    assert check_file(tmp_path / "a.frf.h5").format == "preload-frf-set"


def test_two_raw_files_of_one_name_become_two_files(tmp_path):
    for name in ("run.csv", "run.txt", "other.csv"):
        (tmp_path / name).write_text(TEXTS["samples.csv"][1])
    steps = {name: check_file(tmp_path / name).next_step for name in ("run.csv", "run.txt", "other.csv")}
    outputs = {name: (step.split("--write-map ")[1].split()[0], step.split()[-1]) for name, step in steps.items()}
    assert outputs == {
        "run.csv": ("run.csv.toml", "run.csv.session.h5"),
        "run.txt": ("run.txt.toml", "run.txt.session.h5"),
        "other.csv": ("other.toml", "other.session.h5"),
    }


def test_spectra_alone_are_no_frequency_response(tmp_path):
    (tmp_path / "a.csv").write_text("freq,psd_x,psd_y,psd_z,psd_xyz,mzv(54.8)\n1,2,3,4,9,1\n2,3,4,5,12,1\n")
    report = check_file(tmp_path / "a.csv")
    assert report.valid
    assert (report.uses, report.usable_with_map) == ((), ())
    assert "spectra alone hold no frequency response: take the raw data" in report.next_step
    (tmp_path / "a.csv").write_text("freq,psd_x,re_x,im_x\n1,2,3,4\n2,3,4,5\n")
    assert "--out a.frf.h5" in check_file(tmp_path / "a.csv").next_step
