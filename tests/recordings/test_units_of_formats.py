"""Whatever unit a file of any format states is used, or refused beside the map: it is never ignored.

The same numbers are written in a unit of the file and read with one of the map, or with none.
"""

import math
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings import import_session, read_channel_map
from monitor_core.recordings.check import check_file
from monitor_core.recordings.raw.mapping.imported_frf import import_frf_set
from tests.recordings.test_uff_responses import RESPONSE, written

STEP = 1.0 / 1024.0
NUMBERS = np.sin(np.arange(64) * 0.7)
TIMES = np.arange(64) * STEP
#: Units by what one of them is in N·m and in m/s², from their definitions; none of the others is of the quantity.
TORQUES = {"N.m": 1.0, "Nm": 1.0, "mN.m": 1e-3, "N·mm": 1e-3, "kNm": 1e3, "lbf-in": 0.0254 * 4.4482216152605}
ACCELERATIONS = {"m/s2": 1.0, "m/s^2": 1.0, "mm/s²": 1e-3, "g": 9.80665, "mg": 9.80665e-3, "in/s2": 0.0254}
OTHERS = ("%", "dB", "V", "mm", "m/s", "rpm", "°C", "N", "s", "bar")
UNKNOWN = ("", "EU", "furlong")


def csv_by_name(path, torque, acc):
    names = (f"Torque [{torque}]" if torque else "Torque", f"Acc ({acc})" if acc else "Acc")
    rows = [f"{t!r},{a!r},{a!r}" for t, a in zip(TIMES.tolist(), NUMBERS.tolist(), strict=True)]
    path.write_text("\n".join([f"t,{names[0]},{names[1]}", *rows]) + "\n", encoding="utf-8")
    return names, "time = {channel = 't', unit = 's'}"


def csv_by_row(path, torque, acc):
    rows = [f"{t!r};{a!r};{a!r}" for t, a in zip(TIMES.tolist(), NUMBERS.tolist(), strict=True)]
    path.write_text("\n".join(["t;Torque;Acc", f"s;{torque or '-'};{acc or '-'}", *rows]) + "\n", encoding="utf-8")
    layout = "text = {separator = 'semicolon', header_row = 1, unit_row = 2}"
    return ("Torque", "Acc"), f"time = {{channel = 't', unit = 's'}}\n{layout}"


def xlsx_by_row(path, torque, acc):
    book = pytest.importorskip("openpyxl").Workbook()
    for row in (("t", "Torque", "Acc"), ("s", torque or None, acc or None), *zip(TIMES, NUMBERS, NUMBERS, strict=True)):
        book.active.append(row)
    book.save(path)
    return ("Torque", "Acc"), "time = {channel = 't', unit = 's'}\ntext = {header_row = 1, unit_row = 2}"


def tdms(path, torque, acc):
    nptdms = pytest.importorskip("nptdms")
    common = {"wf_increment": STEP}
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([
            nptdms.ChannelObject("g", name, NUMBERS, properties=common | ({"unit_string": unit} if unit else {}))
            for name, unit in (("Torque", torque), ("Acc", acc))
        ])  # fmt: skip
    return ("g/Torque", "g/Acc"), ""


def mdf4(path, torque, acc):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as file:
        signals = (("Torque", torque), ("Acc", acc))
        file.append([asammdf.Signal(NUMBERS, TIMES, name=name, unit=unit) for name, unit in signals])
        file.header.abs_time = 0
        file.save(path, overwrite=True)
    return ("Torque", "Acc"), ""


def parquet(path, torque, acc):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": unit})
        for name, unit in (("t", "s"), ("Torque", torque), ("Acc", acc))
    ]
    pq.write_table(pa.table([TIMES, NUMBERS, NUMBERS], schema=pa.schema(fields)), path)
    return ("Torque", "Acc"), "time = {channel = 't'}"


def uff58(path, torque, acc):
    pyuff = pytest.importorskip("pyuff")
    path.unlink(missing_ok=True)
    for name, unit in (("Torque", torque), ("Acc", acc)):
        stated = pyuff.prepare_58(
            binary=1, func_type=1, id1=name, rsp_node=1, rsp_dir=3, ref_node=2, ref_dir=3, data=NUMBERS, x=TIMES,
            abscissa_spacing=1, abscissa_min=0.0, abscissa_inc=STEP, ordinate_spec_data_type=0,
            ordinate_axis_units_lab=unit or "NONE", abscissa_axis_units_lab="s", orddenom_spec_data_type=0,
            orddenom_axis_units_lab="NONE",
        )  # fmt: skip
        with warnings.catch_warnings(action="ignore"):  # pyuff leaves its file open
            pyuff.UFF(str(path)).write_sets(stated, "add")
    return ("Torque", "Acc"), ""


def lvm(path, torque, acc):
    head = ["LabVIEW Measurement\t", "Separator\tTab", "X_Columns\tOne", "***End_of_Header***\t", "", "Channels\t2\t"]
    head += ["Samples\t64\t64", f"Y_Unit_Label\t{torque}\t{acc}", "X_Dimension\tTime\tTime"]
    head += ["***End_of_Header***\t\t", "X_Value\tTorque\tAcc\tComment"]
    rows = [f"{t!r}\t{a!r}\t{a!r}" for t, a in zip(TIMES.tolist(), NUMBERS.tolist(), strict=True)]
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
    return ("Torque", "Acc"), ""


WRITERS = {
    "names.csv": csv_by_name, "row.csv": csv_by_row, "a.xlsx": xlsx_by_row, "a.tdms": tdms, "a.mf4": mdf4,
    "a.parquet": parquet, "a.uff": uff58, "a.lvm": lvm,
}  # fmt: skip
MAP = """
axis_id = "a"
excitation = {{channel = "{0}", quantity = "torque", source = "sensor"{2}}}
response = {{channel = "{1}"{3}}}
window = {{position_mm = 0, position_span_mm = 0, started_at = 2025-03-01T06:00:00Z}}
{4}
"""


def used_or_refused(folder, name, in_file, in_map):
    """Read the numbers with a map, and compare each with what both say, or with one of them that says it alone."""
    path = folder / name
    channels, rest = WRITERS[name](path, *in_file)
    said = [f", unit = '{unit}'" if unit else "" for unit in in_map]
    (folder / "map.toml").write_text(MAP.format(*channels, *said, rest), encoding="utf-8")
    factors = []
    for known, of_file, of_map in zip((TORQUES, ACCELERATIONS), in_file, in_map, strict=True):
        stated = {known.get(unit, math.nan) for unit in (of_file, of_map) if unit not in UNKNOWN}
        factors.append(stated.pop() if len(stated) == 1 else math.nan)
    if not all(map(math.isfinite, factors)):
        with pytest.raises(RecordingFormatError):
            import_session([path], read_channel_map(folder / "map.toml"))
        return
    (window,) = import_session([path], read_channel_map(folder / "map.toml")).session.windows
    np.testing.assert_allclose(window.excitation, factors[0] * NUMBERS, rtol=1e-12)
    np.testing.assert_allclose(window.response, factors[1] * NUMBERS, rtol=1e-12)


def drawn(known):
    return st.sampled_from((*known, *OTHERS, *UNKNOWN))


@pytest.mark.parametrize("name", WRITERS)
def test_a_unit_of_each_format_is_used_or_refused(tmp_path, name, subtests):
    cases = [
        (("Nm", "m/s^2"), ("N.m", "m/s2")), (("mN.m", "g"), ("", "")), (("Nm", "g"), ("N.m", "m/s2")),
        (("%", "g"), ("N.m", "g")), (("", "EU"), ("N.m", "mg")), (("", ""), ("N.m", "")),
        (("kNm", "mm/s²"), ("kNm", "")),
    ]  # fmt: skip
    for in_file, in_map in cases:
        with subtests.test(in_file=in_file, in_map=in_map):
            used_or_refused(tmp_path, name, in_file, in_map)


@pytest.mark.release
@pytest.mark.parametrize("name", WRITERS)
def test_any_unit_of_each_format_is_used_or_refused(tmp_path, name):
    @settings(max_examples=500, deadline=None, suppress_health_check=list(HealthCheck))
    @given(drawn(TORQUES), drawn(ACCELERATIONS), st.sampled_from((*TORQUES, "")), st.sampled_from((*ACCELERATIONS, "")))
    def units(torque, acc, said_torque, said_acc):
        used_or_refused(tmp_path, name, (torque, acc), (said_torque, said_acc))

    units()


def test_a_response_whose_file_names_a_velocity_is_no_acceleration(tmp_path):
    text = (
        "axis_id = 'a'\n[frf]\ninput = 'force-at-table'\noutput = 'acceleration-at-table'\nrelative = 0.02\n"
        "response = {channel = 'H', unit = 'm/(N.s2)'}\n[window]\nposition_mm = 250\n"
    )
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    channel_map = read_channel_map(tmp_path / "map.toml")
    for kind, is_taken in ((11, False), (12, True), (8, False), (0, True)):
        labels = {"ordinate_axis_units_lab": "NONE", "orddenom_axis_units_lab": "NONE"}
        (tmp_path / "a.uff").unlink(missing_ok=True)
        written(tmp_path / "a.uff", ("H", RESPONSE), ordinate_spec_data_type=kind, **labels)
        if is_taken:
            assert import_frf_set([tmp_path / "a.uff"], channel_map).responses.measured
        else:
            with pytest.raises(RecordingFormatError, match="the file says that it is a quantity in"):
                import_frf_set([tmp_path / "a.uff"], channel_map)


def test_the_cases_at_hand_are_read_as_they_are_or_refused_with_the_reason(hard_cases, tmp_path):
    refused = {
        "frf_g_per_N.uff": ("frf_map.toml", import_frf_set, "the file says '(g)/(N)'"),
        "bode_db.csv": ("bode_map.toml", import_frf_set, "its name says 'dB'"),
    }
    for name, (of_map, imported, sentence) in refused.items():
        with pytest.raises(RecordingFormatError) as caught:
            imported([hard_cases / name], read_channel_map(hard_cases / of_map))
        assert sentence in str(caught.value)
    (problem,) = check_file(hard_cases / "thousands_german.csv").problems
    assert "row 2, column 'Beschleunigung [mm/s²]'" in problem
    assert problem.endswith("export without thousands separators")
    lvm_file = check_file(hard_cases / "slow_channel.lvm").read.channels
    assert [channel.samples.size for channel in lvm_file.channels] == [512, 512, 512, 50]
    assert check_file(hard_cases / "status_text.mf4").read.channels.names == ("time", "Torque", "Acc")
    text = "axis_id = 'a'\nexcitation = {channel = 'Torque [%]', quantity = 'torque', source = 'drive', unit = 'N.m'}\n"
    text += "response = {channel = 'Acc [g]'}\ntime = {channel = 'Time [s]'}\n"
    text += "window = {position_mm = 0, position_span_mm = 0, started_at = 2025-03-01T06:00:00Z}\n"
    (tmp_path / "map.toml").write_text(text, encoding="utf-8")
    with pytest.raises(RecordingFormatError, match=r"its name says '%'.*N\.m/100%"):
        import_session([hard_cases / "percent_torque.csv"], read_channel_map(tmp_path / "map.toml"))
