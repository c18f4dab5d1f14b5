"""The map that ``check`` writes: few edits make it right, what is missing is refused by name, and it hides nothing.

The truth is the arrays that the files were written from, by the libraries of the formats.
"""

import itertools
import re
import tomllib
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
import scipy.io
from hypothesis import given, strategies as st

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import ExcitationQuantity, ExcitationSource
from monitor_core.recordings import check_file, import_session, read_channel_map
from monitor_core.recordings.raw.channel_time import ChannelTime
from monitor_core.recordings.raw.channels import Channel, Channels, FrequencyResponse
from monitor_core.recordings.raw.inspection import read_as_proposed
from monitor_core.recordings.raw.mapping.times import times_of
from monitor_core.recordings.raw.proposal.entries import printed
from monitor_core.recordings.raw.proposal.map_proposal import proposed_map
from monitor_core.recordings.raw.proposal.sampling import TextTimes, text_times
from monitor_core.recordings.recognition import format_of

CONFIRM, FILL_IN = "# confirm:", "# fill in"

RATE, N = 10_000.0, 4000
TIME = np.arange(N) / RATE
G = 9.80665  # 3rd CGPM, 1901 [m/s²]
MOST_EDITS = 5
RNG = np.random.default_rng(3)
CURRENT, ACCELERATION = RNG.normal(size=N), RNG.normal(size=N)
POSITION = 250.0 + 0.5 * np.sin(2 * np.pi * TIME)  # [mm]
START = datetime(2025, 3, 1, 6, tzinfo=UTC)


def map_text(raw):
    """Return the map that is proposed for a file."""
    read = read_as_proposed(raw, format_of(raw))
    return proposed_map(read.channels, read.layout).toml()


class Filled:
    """A map under a person's hands, who counts what he writes."""

    def __init__(self, text):
        self.text, self.edits = text, 0

    def fill(self, name, value, *, at=None):
        """Fill a place in: take the # away and write the value."""
        place = re.compile(rf"^# {name} =\s*(?={FILL_IN})", re.MULTILINE)
        start = 0 if at is None else self.text.index(f"[{at}]")
        found = place.search(self.text, start)
        assert found, f"no place for {name}"
        self.text = f"{self.text[: found.start()]}{name} = {value} {self.text[found.end() :]}"
        self.edits += 1
        return self

    def correct(self, name, value):
        """Write another value where one was proposed."""
        line = re.compile(rf"^{name} = .*?(?={CONFIRM})", re.MULTILINE)
        assert line.search(self.text), f"{name} was not proposed to be confirmed"
        self.text = line.sub(f"{name} = {value} ", self.text, count=1)
        self.edits += 1
        return self

    @property
    def places(self):
        return re.findall(rf"^# (\w+) =\s*{FILL_IN}", self.text, re.MULTILINE)

    def session(self, raw):
        path = raw.with_suffix(".toml")
        path.write_text(self.text, encoding="utf-8")
        return import_session([raw], read_channel_map(path)).session


def tdms(path):
    nptdms = pytest.importorskip("nptdms")
    times = {"wf_increment": 1 / RATE, "wf_start_time": np.datetime64("2025-03-01T06:00:00")}
    columns = {
        ("Drive", "Iq actual"): (CURRENT, "A"),
        ("Drive", "Position setpoint"): (POSITION, "mm"),
        ("Drive", "Position actual"): (POSITION + 0.001, "mm"),
        ("Nut", "Acceleration Z"): (ACCELERATION, "g"),
    }
    with nptdms.TdmsWriter(str(path)) as writer:
        objects = [
            nptdms.ChannelObject(*name, values, properties={**times, "unit_string": unit})
            for name, (values, unit) in columns.items()
        ]
        writer.write_segment(objects)
    return path


def mat(path, **more):
    scipy.io.savemat(path, {"torque": CURRENT, "accel": ACCELERATION, **more})
    return path


def csv(path):
    rows = (
        f"{1e3 * t!r},{f!r},{a!r}"
        for t, f, a in zip(TIME.tolist(), CURRENT.tolist(), ACCELERATION.tolist(), strict=True)
    )
    path.write_text("\n".join(["Zeit [ms],Kraft (N),Beschleunigung (m/s^2)", *rows]))
    return path


def test_a_tdms_of_a_drive_needs_the_name_of_the_axis_and_takes_the_torque_constant(tmp_path):
    raw = tdms(tmp_path / "2025-03-01.tdms")
    filled = Filled(map_text(raw))
    assert filled.places == []
    (window,) = filled.session(raw).windows
    assert (window.excitation_quantity, window.excitation_source) == (
        ExcitationQuantity.CURRENT,
        ExcitationSource.DRIVE,
    )
    np.testing.assert_array_equal(window.excitation, CURRENT)
    (constant,) = re.findall(r'quantity = "torque", (.*?);', filled.text)  # as the comment says
    (written,) = re.findall('^quantity = "current".*$', filled.text, re.MULTILINE)
    filled.text = filled.text.replace(written, 'quantity = "torque"\n' + constant.replace(", ", "\n"))
    session = filled.correct("axis_id", '"mill-3-x"').session(raw)
    (window,) = session.windows
    assert session.axis_id == "mill-3-x"
    assert (window.excitation_quantity, window.excitation_source) == (ExcitationQuantity.TORQUE, ExcitationSource.DRIVE)
    assert (window.sample_rate, window.started_at) == (pytest.approx(RATE), START)
    np.testing.assert_array_equal(window.excitation, CURRENT * 0.74)
    np.testing.assert_array_equal(window.response, ACCELERATION * G)
    np.testing.assert_array_equal(window.position_trace, (POSITION + 0.001) * 1e-3)  # measured, not the set point


def test_a_mat_without_any_unit_or_time_needs_five_edits(tmp_path):
    raw = mat(tmp_path / "mill-3-x.mat")
    filled = Filled(map_text(raw))
    assert filled.places == ["unit", "unit", "sample_rate_hz", "started_at", "position_mm"]
    filled.fill("unit", '"N.m"', at="excitation").fill("unit", '"g"', at="response").fill("sample_rate_hz", RATE)
    filled.fill("started_at", "2025-03-01T06:00:00Z").fill("position_mm", 250)
    assert filled.edits <= MOST_EDITS
    session = filled.session(raw)
    (window,) = session.windows
    assert (session.axis_id, window.sample_rate, window.started_at) == ("mill-3-x", RATE, START)
    assert (window.conditions.position, window.position_span) == (0.25, 0.0)
    np.testing.assert_array_equal(window.excitation, CURRENT)
    np.testing.assert_array_equal(window.response, ACCELERATION * G)


def test_a_mat_with_times_needs_no_rate(tmp_path):
    raw = mat(tmp_path / "mill-3-x.mat", t=TIME)
    filled = Filled(map_text(raw))
    filled.fill("unit", '"N.m"', at="excitation").fill("unit", '"g"', at="response")
    filled.fill("started_at", "2025-03-01T06:00:00Z").fill("position_mm", 250)
    assert filled.edits <= MOST_EDITS
    assert filled.session(raw).windows[0].sample_rate == pytest.approx(RATE)


def test_a_csv_with_units_in_its_names_needs_start_place_and_axis(tmp_path):
    raw = csv(tmp_path / "hits.csv")
    filled = Filled(map_text(raw))
    filled.fill("started_at", "2025-03-01T06:00:00Z").fill("position_mm", 250).correct("axis_id", '"mill-3-x"')
    assert filled.edits <= MOST_EDITS
    (window,) = filled.session(raw).windows
    assert (window.excitation_quantity, window.excitation_source) == (ExcitationQuantity.FORCE, ExcitationSource.SENSOR)
    assert window.sample_rate == pytest.approx(RATE)  # times in ms
    np.testing.assert_array_equal(window.excitation, CURRENT)
    np.testing.assert_array_equal(window.response, ACCELERATION)


def test_columns_without_names_are_proposed_in_their_order(tmp_path):
    raw = tmp_path / "hit.txt"
    np.savetxt(raw, np.column_stack([TIME, CURRENT, ACCELERATION]))
    filled = Filled(map_text(raw))
    filled.fill("quantity", '"force"').fill("unit", '"N"', at="excitation").fill("unit", '"m/s2"', at="response")
    filled.fill("started_at", "2025-03-01T06:00:00Z").fill("position_mm", 0)
    assert filled.edits <= MOST_EDITS
    (window,) = filled.session(raw).windows
    assert window.excitation_source is ExcitationSource.SENSOR
    np.testing.assert_allclose(window.response, ACCELERATION, rtol=1e-15)


def test_windows_in_an_array_are_proposed_by_its_shape(tmp_path):
    raw = tmp_path / "hits.npz"
    np.savez(raw, force=CURRENT.reshape(20, 200), acceleration=ACCELERATION.reshape(20, 200), number=np.arange(20.0))
    filled = Filled(map_text(raw))
    assert 'windows_in = "rows"' in filled.text
    assert "[time]" not in filled.text  # twenty numbers are not the times of 200 samples
    for name, value in {"sample_rate_hz": RATE, "started_at": START.isoformat(), "position_mm": 1}.items():
        filled.fill(name, value)
    filled.fill("unit", '"N"', at="excitation").fill("unit", '"g"', at="response").fill("window_interval_s", 60)
    assert len(filled.session(raw).windows) == 20


@pytest.mark.parametrize("number", range(5))
def test_each_place_that_is_not_filled_in_is_refused_by_name(tmp_path, number):
    raw = mat(tmp_path / "mill-3-x.mat")
    values = [("unit", '"N.m"'), ("unit", '"g"'), ("sample_rate_hz", RATE), ("started_at", START.isoformat()),
              ("position_mm", 250)]  # fmt: skip
    filled = Filled(map_text(raw))
    for place, (name, value) in enumerate(values):
        if place == number:
            filled.text = filled.text.replace(f"# {name} =", "# left", 1)  # so that the next of this name is filled
        else:
            filled.fill(name, value)
    with pytest.raises(RecordingFormatError) as caught:
        filled.session(raw)
    sentence = str(caught.value)
    assert {"sample_rate_hz": "sample rate"}.get(values[number][0], values[number][0]) in sentence
    assert "\n" not in sentence


def test_every_entry_is_commented_and_every_proposal_is_marked(tmp_path):
    for raw in (tdms(tmp_path / "a.tdms"), mat(tmp_path / "a.mat"), csv(tmp_path / "a.csv")):
        for line in map_text(raw).splitlines():
            if not line.startswith("#") and " = " in line:
                entry, mark, remark = line.partition("#")
                assert entry.strip()
                assert mark
                assert remark.strip()
                assert CONFIRM in line or "as the file says" in line, line


def test_a_map_as_it_is_proposed_is_toml(tmp_path):
    for raw in (tdms(tmp_path / "a.tdms"), mat(tmp_path / "a.mat"), csv(tmp_path / "a.csv")):
        assert "excitation" in tomllib.loads(map_text(raw))


def test_position_and_force_alone_are_a_motion_record():
    columns = {"t": TIME, "Position [m]": POSITION, "Position ref [m]": POSITION, "Force [N]": CURRENT}
    read = Channels("axis.csv", tuple(Channel(name, values) for name, values in columns.items()))
    proposed = tomllib.loads(proposed_map(read).toml())
    assert proposed["motion"]["position"] == {"channel": "Position [m]", "unit": "m"}
    assert proposed["motion"]["force"] == {"channel": "Force [N]", "unit": "N"}
    assert proposed["motion"]["reference"] == {"channel": "Position ref [m]", "unit": "m"}
    assert proposed["time"] == {"channel": "t", "unit": "s"}


def test_columns_of_a_frequency_response_are_a_set_of_responses():
    columns = {"Frequency (Hz)": np.arange(1.0, 100.0), "Real": np.ones(99), "Imag": np.ones(99)}
    read = Channels("frf.csv", tuple(Channel(name, values) for name, values in columns.items()))
    proposed = tomllib.loads(proposed_map(read).toml())["frf"]
    assert proposed["frequency"] == {"channel": "Frequency (Hz)", "unit": "Hz"}
    assert (proposed["real"]["channel"], proposed["imaginary"]["channel"]) == ("Real", "Imag")


def test_responses_of_an_analyser_are_proposed():
    response = FrequencyResponse("Point 1", np.arange(1.0, 9.0), np.ones(8, complex), "m/s^2", "N")
    text = proposed_map(Channels("a.uff", (), (response,))).toml()
    assert tomllib.loads(text)["frf"]["response"] == {"channel": "Point 1", "unit": "m/s2/N"}
    unknown = proposed_map(Channels("a.uff", (), (replace(response, response_unit="furlong"),))).toml()
    assert "fill in: unit of the response, such as m/(N.s2); the file says furlong per N" in unknown


def test_two_clocks_ask_for_a_rate():
    channels = (
        Channel("Torque", CURRENT, "Nm", ChannelTime(clock="Time 1")),
        Channel("Acceleration", ACCELERATION, "g", ChannelTime(clock="Time 2")),
        Channel("Time 1", TIME, "s"), Channel("Time 2", TIME + 5e-4, "s"),
    )  # fmt: skip
    filled = Filled(proposed_map(Channels("scope.csv", channels)).toml())
    assert "[resample]" in filled.text
    equal = (*channels[:3], Channel("Time 2", TIME, "s"))
    assert "[resample]" not in proposed_map(Channels("scope.csv", equal)).toml()
    assert filled.places == ["sample_rate_hz", "started_at", "position_mm"]


def test_numbers_of_samples_with_a_leap_ask_for_their_rate_and_are_no_milliseconds(tmp_path):
    number = np.arange(CURRENT.size) + 37.0 * (np.arange(CURRENT.size) >= 300)
    np.savez(tmp_path / "a.npz", Counter=number, Torque=CURRENT, Acceleration=ACCELERATION)
    filled = Filled(map_text(tmp_path / "a.npz"))
    of_time = filled.text.partition("[time]")[2].partition("\n\n")[0]
    assert 'channel = "Counter"' in of_time
    assert '"ms"' not in of_time
    assert "of the samples that it numbers; or unit, if these are times" in of_time
    filled.fill("sample_rate_hz", "1024", at="time")
    assert filled.text.count("sample_rate_hz") == 1


@given(st.text(st.characters(exclude_categories=("Cs",))))
def test_any_name_is_read_back_from_the_map_and_moves_no_cursor(name):
    assert tomllib.loads(f"channel = {printed(name)}") == {"channel": name}
    assert all(letter.isprintable() for letter in printed(name))


# ---- texts --------------------------------------------------------------------------------------------------------

TEXTS = {
    "iso with zone": (
        {"t": ["2025-03-01T06:00:00.5+01:00"]},
        TextTimes("t", None, "iso", is_dated=True, has_zone=True),
    ),
    "iso": ({"t": ["2025-03-01 06:00:00"]}, TextTimes("t", None, "iso", is_dated=True, has_zone=False)),
    "german, split": (
        {"Datum": ["25.03.2025"], "Uhrzeit": ["06:00:00,001"]},
        TextTimes("Uhrzeit", "Datum", "%d.%m.%Y %H:%M:%S,%f", is_dated=True, has_zone=False),
    ),
    "american, a late day": (
        {"t": ["3/1/2025 6:00:00", "3/25/2025 6:00:00"]},
        TextTimes("t", None, "%m/%d/%Y %H:%M:%S", is_dated=True, has_zone=False),
    ),
    "a day that may be a month": ({"t": ["3/1/2025 6:00"]}, TextTimes("t", None, None, is_dated=True, has_zone=False)),
    "time of day": ({"t": ["06:00:00.25"]}, TextTimes("t", None, "%H:%M:%S.%f", is_dated=False, has_zone=False)),
    "remarks": ({"remark": ["start", "stop"], "none": []}, None),
}


@pytest.mark.parametrize("case", TEXTS)
def test_texts_of_date_and_time_are_proposed_and_never_settled_by_a_guess(case):
    columns, expected = TEXTS[case]
    assert text_times(columns) == expected


def test_the_pattern_that_is_proposed_reads_the_times_as_python_does():
    columns, proposed = TEXTS["german, split"]
    text = f"{columns['Datum'][0]} {columns['Uhrzeit'][0]}"
    expected = datetime(2025, 3, 25, 6, 0, 0, 1000, tzinfo=UTC)
    assert datetime.strptime(text, proposed.form).replace(tzinfo=UTC) == expected


def test_how_a_text_is_written_is_proposed_with_it(tmp_path):
    rows = [f"25.03.2025;06:00:{k // 100:02d},{k % 100:02d};1,{k % 7};0,{k % 5}" for k in range(500)]
    head = ["Logger XY 2000", "", "Datum;Uhrzeit;Kraft [N];Beschleunigung [m/s²]"]
    (tmp_path / "log.csv").write_bytes("\r\n".join([*head, *rows]).encode("latin-1"))
    text = map_text(tmp_path / "log.csv")
    proposed = tomllib.loads(text)
    assert proposed["text"] == {"separator": "semicolon", "decimal": "comma", "header_row": 3, "encoding": "latin-1"}
    assert proposed["time"] == {"channel": "Uhrzeit", "date": "Datum", "format": "%d.%m.%Y %H:%M:%S,%f"}
    assert Filled(text).places == ["zone", "position_mm"]


def signals_and(**numbers):
    return {"torque": CURRENT, "acc": ACCELERATION, **numbers}


def test_a_single_number_that_is_named_so_is_proposed_as_the_rate(tmp_path, subtests):
    for write, (numbers, rate) in itertools.product(
        [
            lambda path, **single: scipy.io.savemat(path / "a.mat", {"rec": signals_and(**single)}),
            lambda path, **single: scipy.io.savemat(path / "a.mat", signals_and(**single), format="4"),
            lambda path, **single: np.savez(path / "a.npz", **signals_and(**single)),
        ],
        [
            ({"Fs": 4096, "gain": 3.0}, 4096.0),
            ({"sampling_rate": 2048.5}, 2048.5),
            ({"dt": 1 / 2560}, 2560.0),
            ({"Fs": 1000, "dt": 1e-3}, 1000.0),
            ({"Fs": 1000, "dt": 1e-4}, None),
            ({"Fs": 0.0}, None),
            ({"Fs": np.nan}, None),
            ({"gain": 4096.0}, None),
        ],
    ):
        with subtests.test(write=write, numbers=numbers):
            write(tmp_path, **numbers)
            (raw,) = tmp_path.iterdir()
            window = tomllib.loads(map_text(raw))["window"]
            raw.unlink()
            assert window.get("sample_rate_hz") == (None if rate is None else pytest.approx(rate, rel=1e-11))


def test_the_rate_of_a_single_number_stands_in_the_report_and_reaches_the_session(tmp_path):
    raw = tmp_path / "mill-3-x.mat"
    scipy.io.savemat(raw, {"rec": signals_and(Fs=RATE)})
    assert ("single_numbers", (f"rec.Fs: {RATE:g}",)) in check_file(raw).contents
    filled = Filled(map_text(raw))
    filled.fill("unit", '"N.m"').fill("unit", '"m/s2"').fill("started_at", "2025-03-01T06:00:00Z")
    assert filled.fill("position_mm", 250).session(raw).windows[0].sample_rate == RATE


EVIL = "\x1b[2J\x07\x9b31m\r\nx = 1\u202e\u2066"


def test_a_name_of_control_characters_neither_moves_the_cursor_nor_adds_a_line(tmp_path):
    raw = tmp_path / "a.npz"
    np.savez(raw, **{f"torque{EVIL}": CURRENT, f"acc{EVIL}": ACCELERATION})
    text = map_text(raw)
    assert all(letter.isprintable() for letter in text.replace("\n", ""))
    proposed = tomllib.loads(text)
    assert proposed["excitation"]["channel"] == f"torque{EVIL}"
    assert "x" not in proposed


@pytest.mark.parametrize("form", ["2025-03-01T06:00:{:09.6f}Z", "01.03.2025 06:00:{:06.3f}", "{:.3f}"])
def test_a_window_is_the_plain_number_of_samples_in_a_second(tmp_path, form):
    path = tmp_path / "a.csv"
    rows = (f"{form.format(i / 2048)};{i % 7};{i % 5}\n" for i in range(2048 * 20))
    path.write_text("time_s;F;acc\n" + "".join(rows))
    assert "samples_per_window = 2048 " in map_text(path)


@pytest.mark.parametrize(
    ("text", "form"),
    [
        ("3/25/2025 6:00:01.5 PM", "%m/%d/%Y %I:%M:%S.%f %p"),
        ("25.03.2025 06:00AM", "%d.%m.%Y %I:%M%p"),
        ("6:00:01 pm", "%I:%M:%S %p"),
    ],
)
def test_hours_of_half_a_day_are_proposed_as_such(text, form):
    found = text_times({"t": [text]})
    assert found is not None
    assert found.form == form
    times_of([text], form, None, None, "a.csv")


def xlsx(path, *sheets):
    """Write sheets, each a name and what stands above the samples."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    samples = list(zip(TIME.tolist(), CURRENT.tolist(), ACCELERATION.tolist(), strict=True))
    for name, above, has_samples in sheets:
        sheet = book.create_sheet(name)
        for row in (*above, *(samples if has_samples else ())):
            sheet.append(row)
    book.save(path)
    return path


TITLES = [("Messprotokoll Spindel 3",), ("Datum", "2025-03-01"), ()]
NAMES, UNITS = ("Zeit", "Kraft", "Beschleunigung"), ("s", "N", "m/s²")


@pytest.mark.parametrize(
    ("above", "text"),
    [
        ([*TITLES, NAMES, UNITS], {"header_row": 4, "unit_row": 5}),
        ([NAMES, UNITS], {"header_row": 1, "unit_row": 2}),
        ([*TITLES, NAMES, UNITS, ("---", "---", "---")], {"header_row": 4, "unit_row": 5, "first_row": 7}),
        ([("Messung 7",), ("Zeit [s]", "Kraft [N]", "Beschleunigung [m/s²]")], {"header_row": 2}),
    ],
    ids=["titles", "units", "a line", "units in names"],
)
@pytest.mark.parametrize(
    "others",
    [
        pytest.param([], id="one sheet", marks=pytest.mark.release),
        pytest.param([("Notes", [("made by", "Meyer")], False)], id="two sheets"),
    ],
)
def test_rows_of_a_workbook_are_proposed_as_those_of_a_text(tmp_path, above, text, others):
    """Without the proposal the reader refuses each of them; with it, the samples are those written."""
    raw = xlsx(tmp_path / "mill-3-x.xlsx", *others, ("Data", above, True))
    filled = Filled(map_text(raw))
    assert tomllib.loads(filled.text)["text"] == text | ({"sheet": "Data"} if others else {})
    filled.fill("started_at", "2025-03-01T06:00:00Z").fill("position_mm", 250)
    session = filled.session(raw)
    assert (session.windows[0].sample_rate, session.windows[0].excitation_quantity) == (RATE, ExcitationQuantity.FORCE)
    for samples, values in ((session.windows[0].excitation, CURRENT), (session.windows[0].response, ACCELERATION)):
        np.testing.assert_array_equal(samples, [float(f"{value:.16g}") for value in values])  # digits of a workbook


def test_a_workbook_without_a_table_keeps_the_sentence_of_its_reader(tmp_path):
    raw = xlsx(tmp_path / "notes.xlsx", ("Notes", [("made by", "Meyer"), ("at", "noon")], False))
    with pytest.raises(RecordingFormatError, match=r"got only what is not read: made by \(texts\)"):
        map_text(raw)
