"""``preload check``: what it answers, writes and draws; and no control character of a file reaches a terminal."""

import ast
import itertools
import json
import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from monitor_core.recording import Conditions, Session, Window
from monitor_core.recordings import write_session
from monitor_core.recordings.raw import formats
from monitor_core.recordings.raw.channels import Channels
from service.cli import check
from service.documents.printable import printable
from service.report.channel_page import envelope
from tests.conftest import PROJECT_ROOT, canary
from tests.service.test_cli import assert_refused

TABLE = PROJECT_ROOT / "replay_data" / "published" / "nguyen_table2.csv"
MODEL = PROJECT_ROOT / "replay_data" / "models" / "lumped.toml"
RNG = np.random.default_rng(1)
SAMPLES = RNG.normal(size=(2, 3000))


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run commands in a folder of their own."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    """Return a MATLAB file of two signals and their times."""
    path = tmp_path / "moves.mat"
    clipped = np.minimum(SAMPLES[1], 0.7)
    scipy.io.savemat(path, {"t": np.arange(3000) / 5e3, "torque": SAMPLES[0], "acc": clipped})
    return path


def session_file(path: Path, axis: str = "mill-3-x", measurement: str = "m") -> Path:
    start = datetime(2025, 3, 1, tzinfo=UTC)
    windows = tuple(
        Window(*SAMPLES, 5e3, start + timedelta(minutes=i), Conditions(0.25 * i), f"{measurement}{i}") for i in range(3)
    )
    write_session(path, Session(axis, windows))
    return path


# ---- answers ------------------------------------------------------------------------------------------------------


def test_json_lists_the_channels_and_what_comes_next(preload: Any, raw: Path) -> None:
    document = preload("check", raw, "--json").json()
    assert [document[key] for key in ("format", "valid", "problems", "usable_by")] == ["mat", True, [], ["import"]]
    assert "frf" in document["usable_with_map"]
    assert document["next_step"].startswith(f"preload check {raw} --write-map moves.toml")
    channels = {channel["name"]: channel for channel in document["channels"]}
    assert list(channels) == ["t", "torque", "acc"]
    assert channels["torque"]["shape"] == [3000]
    assert [channels["torque"][key] for key in ("unit", "sample_rate_hz", "started_at")] == [None, None, None]
    assert channels["torque"]["first_values"] == SAMPLES[0, :5].tolist()
    assert [channels[name]["clipped"] for name in ("torque", "acc")] == [False, True]
    assert [channels[name]["looks_like"] for name in channels] == ["time", "torque", "acceleration"]


def test_a_person_reads_the_same(preload: Any, raw: Path) -> None:
    answer = preload("check", raw)
    assert answer.exit_code == 0
    assert answer.out.startswith("moves.mat: mat, valid\n")
    for words in ("torque", "3000", "clipped", "Commands that take it, with a channel map:", "Next: preload check"):
        assert words in answer.out


def test_a_session_is_told_in_json_with_its_times(preload: Any, tmp_path: Path) -> None:
    document = preload("check", session_file(tmp_path / "a.session.h5"), "--json").json()
    assert document["contents"]["windows"] == 3
    assert document["contents"]["positions_mm"] == [0.0, 250.0, 500.0]
    assert [channel["name"] for channel in document["channels"]] == ["excitation", "response"]
    first = document["channels"][0]
    assert (first["shape"], first["unit"], first["sample_rate_hz"]) == ([3, 3000], "N.m", 5000.0)
    assert first["started_at"] == "2025-03-01T00:00:00+00:00"


def test_what_check_says_is_usable_is_used(preload: Any, tmp_path: Path) -> None:
    calibration = tmp_path / "axis.json"
    assert preload("calibrate", TABLE, "--out", calibration).exit_code == 0
    placed = {"CALIBRATION": str(calibration), "DATA": str(TABLE), "X": "300", "P": "200"}
    session = session_file(tmp_path / "a.session.h5")
    tried = set()
    for path in (TABLE, calibration, MODEL, session):
        for command, line in preload("check", path, "--json").json()["commands"].items():
            words = [placed.get(word, word) for word in line.split()[1:]]
            if command in ("modes", "calibrate", "estimate", "frf"):  # the others take a service, or minutes
                answer = preload(*words)
                assert answer.exit_code == 0, f"{line}: {answer.err}"
                tried.add((path.name, command))
    assert len(tried) == 7


def test_what_check_leaves_out_is_refused(preload: Any, tmp_path: Path) -> None:
    session = session_file(tmp_path / "a.session.h5")
    assert "calibrate" not in preload("check", session, "--json").json()["usable_by"]
    assert_refused(preload("calibrate", session), "preload_n")
    table = tmp_path / "t.csv"
    table.write_text("position_mm,frequency_hz\n250,189\n500,180\n")
    assert "calibrate" not in preload("check", table, "--json").json()["usable_by"]
    assert_refused(preload("calibrate", table), "preload")


REFUSED: dict[str, tuple[tuple[str | Path, ...], str]] = {
    "raw to frf": (("frf", "moves.mat"), "preload import moves.mat --map moves.toml --out moves.session.h5"),
    "raw to replay": (("replay", "moves.mat", "--url", "http://x", "--axis", "a"), "got a MATLAB file"),
    "raw to calibrate": (("calibrate", "moves.mat"), "expected a session or a modal table (position_mm,frequency_hz)"),
    "raw to explain": (("explain", "moves.mat", "--baseline", MODEL), "preload check moves.mat --write-map"),
    "raw to identify": (("identify", "moves.mat", "--model", MODEL), "preload check moves.mat --write-map"),
    "table as calibration": (("estimate", TABLE, "--calibration", TABLE), "got a modal table: preload calibrate"),
    "table as prior": (("calibrate", TABLE, "--prior", TABLE), "expected a calibration; got a modal table"),
    "model as data": (("estimate", MODEL, "--calibration", MODEL), "got a drive model in TOML"),
    "model to calibrate": (("calibrate", MODEL), "got a drive model in TOML: preload modes"),
    "data as model": (("modes", TABLE, "--position-mm", "1"), "expected a drive model in TOML; got a modal table"),
    "folder": (("check", "."), ": expected a file; got a folder"),
    "picture": (("frf", "p.png"), "got a PNG picture"),
}


def test_every_command_says_what_a_wrong_file_is(
    preload: Any, raw: Path, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    for case, (words, complaint) in REFUSED.items():
        with subtests.test(case=case):
            (tmp_path / "p.png").write_bytes(b"\x89PNG\r\n\x1a\n")
            answer = preload(*words)
            assert answer.exit_code == 2
            assert answer.err.count("\n") == 1
            assert complaint in answer.err


# ---- what is written ----------------------------------------------------------------------------------------------


def test_a_map_is_written_and_one_that_is_there_is_left_alone(preload: Any, raw: Path, tmp_path: Path) -> None:
    answer = preload("check", raw, "--write-map", "moves.toml")
    assert answer.exit_code == 0
    assert "Written: moves.toml" in answer.out
    assert "fill in its 4 marked places" in answer.out
    (tmp_path / "moves.toml").write_text("filled in")
    assert_refused(preload("check", raw, "--write-map", "moves.toml"), "it is already there")
    assert (tmp_path / "moves.toml").read_text() == "filled in"


def test_a_raw_file_is_read_once_whatever_is_written(
    preload: Any, raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table of 70 MB takes 17 s to read."""
    read, readings = formats.READERS[".mat"], list[Path]()

    def counted(path: Path) -> Channels:
        readings.append(path)
        return read(path)

    monkeypatch.setitem(formats.READERS, ".mat", counted)
    monkeypatch.setattr(check, "read_foreign", lambda work, _: work())  # here, where readings are counted
    assert preload("check", raw, "--write-map", "moves.toml", "--plot", "moves.html").exit_code == 0
    assert (tmp_path / "moves.toml").exists()
    assert (tmp_path / "moves.html").exists()
    assert len(readings) == 1


def test_the_file_that_is_looked_at_is_not_written_over(preload: Any, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time_s,torque_nm\n0,1\n0.1,2\n")
    (tmp_path / "page.html").symlink_to("log.csv")
    assert_refused(preload("check", "log.csv", "--plot", "page.html"), "it is read by this command, and would be lost")
    assert_refused(preload("check", "log.csv", "--write-map", "log.csv"), "a channel map ends in .toml; got log.csv")


def test_what_cannot_be_written_is_refused_before_the_work(preload: Any, tmp_path: Path) -> None:
    for option in ("--write-map=no/such.toml", "--plot=no/such.html"):
        assert_refused(preload("check", "missing.mat", option), "folder no does not exist")
    assert_refused(preload("check", "missing.mat", "--json", "--plot", "-"), "--plot the name of a page")


def test_a_session_needs_no_map(preload: Any, tmp_path: Path) -> None:
    session_file(tmp_path / "a.session.h5")
    assert_refused(preload("check", "a.session.h5", "--write-map", "a.toml"), "got a session")
    assert not (tmp_path / "a.toml").exists()


@pytest.mark.parametrize("words", [("FILE", "--plot"), ("--plot", "FILE"), ("--plot", "--json", "FILE")])
def test_plot_alone_writes_a_page_of_the_files_name(preload: Any, raw: Path, tmp_path: Path, words: Any) -> None:
    assert preload("check", *(raw if word == "FILE" else word for word in words)).exit_code == 0
    assert (tmp_path / "moves.mat.html").exists()


def test_the_page_needs_nothing_else(preload: Any, raw: Path, tmp_path: Path) -> None:
    assert preload("check", raw, "--plot", "page.html").exit_code == 0
    assert_refused(
        preload("check", raw, "--plot", "page.png"), "a page of HTML, whose name ends in .html; got page.png"
    )
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 3
    assert not re.search(r"<script|<link|<img|src=|https?:|url\(|@import", page)
    assert "clipped: piles up" in page


def test_a_picture_fits_a_terminal(preload: Any, raw: Path, tmp_path: Path) -> None:
    answer = preload("check", raw, "--plot", "-")
    assert answer.exit_code == 0
    drawn = [line for line in answer.out.splitlines() if any("\u2800" <= letter <= "\u28ff" for letter in line)]
    assert len(drawn) == 15
    assert max(map(len, drawn)) <= 120
    assert not list(tmp_path.glob("*.html"))


def test_a_session_is_drawn_too(preload: Any, tmp_path: Path) -> None:
    session_file(tmp_path / "a.session.h5")
    assert preload("check", "a.session.h5", "--plot").exit_code == 0
    assert (tmp_path / "a.session.h5.html").read_text(encoding="utf-8").count("<svg") == 2
    assert_refused(preload("check", TABLE, "--plot"), "--plot draws channels")


def test_no_sample_of_a_record_lies_outside_its_picture() -> None:
    samples = RNG.normal(size=100_003)
    samples[54_321], samples[7] = 99.0, np.nan
    lows, highs = envelope(samples, 800)
    assert lows.size == 800
    assert (np.nanmax(highs), np.nanmin(lows)) == (99.0, np.nanmin(samples))
    assert all(values.size == 3 for values in envelope(np.arange(3.0), 800))
    assert np.isnan(envelope(np.full(9, np.inf), 3)[0]).all()


@pytest.mark.parametrize("value", [0.0, 1e308, -1e-320, np.nan, np.inf])
def test_any_number_can_be_drawn(preload: Any, tmp_path: Path, value: float) -> None:
    np.savez(tmp_path / "a.npz", x=np.array([value, value, -value]))
    assert preload("check", "a.npz", "--plot").exit_code == 0
    assert preload("check", "a.npz", "--plot", "-").exit_code == 0


# ---- control characters -------------------------------------------------------------------------------------------

#: ESC with a control sequence, its one-byte form, BEL, line ends, DEL, and marks that turn the direction of writing.
EVIL = "\x1b[2J\x9b31m\x07\r\n\x7f\u202e\u2066\u200f[red]"
ALLOWED = "\n"


def evil_raw(folder: Path) -> tuple[str | Path, ...]:
    np.savez(folder / "evil.npz", **{f"torque{EVIL}": SAMPLES[0], f"acc{EVIL}": SAMPLES[1]})
    return ("check", "evil.npz")


def evil_file_name(folder: Path) -> tuple[str | Path, ...]:
    name = f"evil{EVIL}.npz"
    np.savez(folder / "plain.npz", torque=SAMPLES[0])
    (folder / "plain.npz").rename(folder / name)
    return ("check", name)


def evil_units(folder: Path) -> tuple[str | Path, ...]:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(str(folder / "evil.tdms")) as writer:
        writer.write_segment([nptdms.ChannelObject("a", "b", SAMPLES[0], properties={"unit_string": f"V{EVIL}"})])
    return ("check", "evil.tdms")


def evil_cell(folder: Path) -> tuple[str | Path, ...]:
    (folder / "evil.csv").write_text("position_mm,frequency_hz\n1,\x1b[2J\x07\u202e\n")
    return ("check", "evil.csv")


def evil_header(folder: Path) -> tuple[str | Path, ...]:
    (folder / "evil.csv").write_text("position_mm,frequency\x1b[2J\x07\u202e\n1,2\n")
    return ("calibrate", "evil.csv")


def evil_axis(folder: Path) -> tuple[str | Path, ...]:
    session_file(folder / "evil.session.h5", axis=f"axis{EVIL}")
    return ("check", "evil.session.h5")


def evil_measurement(folder: Path) -> tuple[str | Path, ...]:
    session_file(folder / "evil.session.h5", measurement=f"m{EVIL}")
    return ("frf", "evil.session.h5")


def evil_map(folder: Path) -> tuple[str | Path, ...]:
    text = EVIL.encode("unicode_escape").decode().replace("\\x", "\\u00")
    (folder / "evil.toml").write_text(f'axis_id = "a"\n"{text}" = 1\n')
    return ("check", "evil.toml")


def evil_option(folder: Path) -> tuple[str | Path, ...]:
    del folder
    return ("check", f"--{EVIL}")


EVIL_PLACES: dict[str, Callable[[Path], tuple[str | Path, ...]]] = {
    "channel": evil_raw, "file name": evil_file_name, "unit": evil_units, "cell": evil_cell, "header": evil_header,
    "axis": evil_axis, "measurement": evil_measurement, "map": evil_map, "option": evil_option,
}  # fmt: skip


def obeyed(text: str) -> set[str]:
    """Return what a terminal would obey."""
    return {letter for letter in text if not letter.isprintable() and letter not in ALLOWED}


def test_no_control_character_reaches_the_terminal(preload: Any, tmp_path: Path, subtests: pytest.Subtests) -> None:
    for place, more in itertools.product(EVIL_PLACES, [(), ("--json",)]):
        with subtests.test(place=place, more=more):
            answer = preload(*EVIL_PLACES[place](tmp_path), *more)
            assert not obeyed(answer.out + answer.err)
            assert answer.exit_code in (0, 2)
            shown = answer.out + answer.err
            assert "\\x1b" in shown or "\\u001b" in shown  # seen, not hidden


@pytest.mark.parametrize("place", canary(["channel", "file name", "unit", "axis"]))
def test_no_control_character_reaches_page_picture_or_map(preload: Any, tmp_path: Path, place: str) -> None:
    command, name = EVIL_PLACES[place](tmp_path)
    assert preload(command, name, "--plot", "page.html").exit_code == 0
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert not obeyed(page)
    assert "\\x1b" in page
    assert not obeyed(preload(command, name, "--plot", "-").out)
    if place != "axis":
        assert preload(command, name, "--write-map", "map.toml").exit_code == 0
        assert not obeyed((tmp_path / "map.toml").read_text(encoding="utf-8"))


def test_markup_of_a_file_is_text_in_table_and_page(preload: Any, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **{"[bold]x[/bold]<script>alert(1)</script>": SAMPLES[0], "[/]": SAMPLES[1]})
    answer = preload("check", "a.npz", "--plot", "page.html")
    assert answer.exit_code == 0
    assert "[bold]x" in answer.out
    assert "[/]" in answer.out
    assert "<script" not in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_spaces_and_letters_of_all_countries_are_left_as_they_are() -> None:
    text = "Beschleunigung längs, 12\u00a0N·m, Ось 3, 主軸, ±0.1"
    assert printable(text) == text
    assert printable("a\tb\u2028c\udc80") == "a\\tb\\u2028c\\udc80"


def test_commands_print_by_way_of_the_module_that_escapes() -> None:
    exempt = {"output.py", "main.py", "serve.py"}  # main prints help, serve the service's own address and settings
    for path in sorted((PROJECT_ROOT / "service" / "cli").rglob("*.py")):
        calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
        names = {ast.unparse(call.func) for call in calls}
        assert path.name in exempt or not names & {"click.echo", "click.secho", "print"}, path


def test_json_stays_one_document_with_every_name_in_full(preload: Any, tmp_path: Path) -> None:
    answer = preload(*evil_raw(tmp_path), "--json")
    assert json.loads(answer.out)["channels"][0]["name"] == f"torque{EVIL}"
