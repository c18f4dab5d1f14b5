"""Write text files in the manners of real loggers, with the numbers that they hold, by no code of the product."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

N_ROWS = 60
#: Start of an export that pytcs (its README) prints as 2022-05-02T13:56:24.376 UTC; ticks of 100 ns since 1601.
TWINCAT_START = 132959733843760000


@dataclass(frozen=True)
class LoggerFile:
    """A file and its truth. ``layout`` holds what must be proposed; None: it is read without one."""

    content: bytes
    channels: dict[str, list[float]]
    layout: dict[str, str | int] | None = None
    texts: dict[str, list[str]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    says: str = ""  # in the refusal without a layout


def columns(seed: int, n_rows: int = N_ROWS) -> tuple[list[str], list[str], list[str]]:
    """Return times, forces and accelerations as decimal texts, with points."""
    rng = np.random.default_rng(seed)
    times = [f"{0.0002 * i:.4f}" for i in range(n_rows)]
    forces = [f"{value:.6f}" for value in 40.0 * rng.normal(size=n_rows)]
    accelerations = [f"{value:.7e}" for value in rng.normal(size=n_rows)]
    return times, forces, accelerations


def numbers(texts: Sequence[str]) -> list[float]:
    """Return the nearest doubles of decimal texts."""
    return [float(text) for text in texts]


def table(*texts: Sequence[str], separator: str = ",", end: str = "\n", comma: bool = False, last: str = "") -> str:
    """Lay out columns as rows."""
    rows = (separator.join(cells) + last for cells in zip(*texts, strict=True))
    return "".join((row.replace(".", ",") if comma else row) + end for row in rows)


def quoted(*texts: Sequence[str], comma: bool = False) -> str:
    """Lay out columns as rows of cells in quotes."""
    cells = ([f'"{text.replace(".", ",") if comma else text}"' for text in row] for row in zip(*texts, strict=True))
    return "".join(",".join(row) + "\r\n" for row in cells)


def logger_files() -> dict[str, LoggerFile]:
    """Return files by the manner in which they are written."""
    t, f, a = columns(1)
    truth = {"t": numbers(t), "F": numbers(f), "a": numbers(a)}
    german = {"Zeit": truth["t"], "Kraft": truth["F"], "Beschl": truth["a"]}
    iso = [f"2025-03-01T06:00:00.{i:06d}" for i in range(0, N_ROWS * 200, 200)]
    days = ["01.03.2025"] * N_ROWS
    hours = [f"06:00:{i:02d}" for i in range(N_ROWS)]
    fine = [f"06:00:{i:02d},500" for i in range(N_ROWS)]
    counts = [str(32768 + i % 7) for i in range(N_ROWS)]
    short = {"separator": "semicolon", "decimal": "comma", "header_row": 1}
    files = {
        "plain comma": LoggerFile(f"t,F,a\n{table(t, f, a)}".encode(), truth),
        "plain, names in quotes": LoggerFile(f'"t","F","a"\n{table(t, f, a)}'.encode(), truth),
        "plain, a comma in a quoted name": LoggerFile(
            f'"t","Force, measured"\n{table(t, f)}'.encode(), {"t": truth["t"], "Force, measured": truth["F"]}
        ),
        "old Macintosh line ends": LoggerFile(f"t,F,a\r{table(t, f, a, end=chr(13))}".encode(), truth),
        "German spreadsheet": LoggerFile(
            ("Zeit;Kraft;Beschl\r\n" + table(t, f, a, separator=";", end="\r\n", comma=True)).encode(),
            german, short, says="decimal commas",
        ),
        "German spreadsheet in Latin-1 with units": LoggerFile(
            ("Zeit;Kraft;Beschl\r\ns;N;m/s²\r\n" + table(t, f, a, separator=";", comma=True)).encode("latin-1"),
            german, short | {"unit_row": 2, "encoding": "latin-1"},
            units={"Zeit": "s", "Kraft": "N", "Beschl": "m/s²"}, says="Latin-1",
        ),
        "semicolon at the end of each row": LoggerFile(
            ("Zeit;Kraft;Beschl;\n" + table(t, f, a, separator=";", comma=True, last=";")).encode(), german, short,
            says="a semicolon at the end of each row",
        ),
        "trailing comma in the rows alone": LoggerFile(
            ("t,F,a\n" + table(t, f, a, last=",")).encode(), truth, {"separator": "comma", "header_row": 1},
            says="a comma at the end of each row",
        ),
        "oscilloscope: x-axis and units in words": LoggerFile(
            f"x-axis,1\nsecond,Volt\n{table(t, f)}".encode(), {"second": truth["t"], "Volt": truth["F"]},
            {"separator": "comma", "header_row": 2},
            says="1 row above its names",
        ),
        "oscilloscope: preamble and TIME,CH1": LoggerFile(
            ("Model,MSO\nFirmware,1.2\n\nSample Interval,2E-4\nRecord Length,60\nVertical Units,V\n\n\nTIME,CH1,CH2\n"
             + table(t, f, a, end="\r\n")).encode(),
            {"TIME": truth["t"], "CH1": truth["F"], "CH2": truth["a"]}, {"separator": "comma", "header_row": 9},
            says="8 rows above its names",
        ),
        "LabVIEW spreadsheet: preamble, names, units, a stray row": LoggerFile(
            ("C:\\data\\test.txt\nProgrammer - nobody\nSampling Frequency - 5000\nTue, Jul 19, 2022 10:55 PM\n"
             "F\ta\tTime\nVoltage (unscaled)\tVoltage (unscaled)\tSec\n0.0 0.0\t0\t\t0 0 0\n\n"
             + table(f, a, t, separator="\t")).encode(),
            {"F": truth["F"], "a": truth["a"], "Time": truth["t"]},
            {"separator": "tab", "header_row": 5, "unit_row": 6, "first_row": 9},
            units={"F": "Voltage (unscaled)", "Time": "Sec"}, says="a row of units",
        ),
        "units in brackets": LoggerFile(
            ("t\tF\ta\n[s]\t[N]\t[m/s²]\n" + table(t, f, a, separator="\t")).encode(), truth,
            {"separator": "tab", "header_row": 1, "unit_row": 2}, units={"t": "s", "F": "N", "a": "m/s²"},
            says="a row of units",
        ),
        "numpy.savetxt with a header": LoggerFile(
            ("# t,F,a\n" + table(t, f, a)).encode(), {"# t": truth["t"], "F": truth["F"], "a": truth["a"]}
        ),
        "numpy.savetxt with a header of two rows": LoggerFile(
            ("# 5 kHz\n# t F a\n" + table(t, f, a, separator=" ")).encode(), truth,
            {"separator": "blank", "header_row": 2, "comment": "#"}, says="rows that begin with '#'",
        ),
        "comments between the rows": LoggerFile(
            ("t,F,a\n" + table(t[:9], f[:9], a[:9]) + "# trigger\n" + table(t[9:], f[9:], a[9:])).encode(), truth,
            {"separator": "comma", "header_row": 1, "comment": "#"}, says="rows that begin with '#'",
        ),
        "MATLAB comments above": LoggerFile(
            ("% recorded by hand\n% 5 kHz\nt F a\n" + table(t, f, a, separator="  ")).encode(), truth,
            {"separator": "blank", "header_row": 3}, says="2 rows above its names",
        ),
        "a word at the end": LoggerFile(
            ("t,F,a\n" + table(t, f, a) + "EOF\n").encode(), truth,
            {"separator": "comma", "header_row": 1, "comment": "EOF"}, says="rows that begin with 'EOF'",
        ),
        "all cells in quotes": LoggerFile(
            ('"t","F","a"\r\n' + quoted(t, f, a)).encode(), truth, {"separator": "comma", "header_row": 1},
            says="cells in quotes",
        ),
        "decimal commas in quotes between commas": LoggerFile(
            ('"t","F","a"\r\n' + quoted(t, f, a, comma=True)).encode(), truth,
            {"separator": "comma", "decimal": "comma", "header_row": 1}, says="decimal commas and cells in quotes",
        ),
        "ISO times": LoggerFile(
            ("Timestamp,F,a\n" + table(iso, f, a)).encode(), {"F": truth["F"], "a": truth["a"]},
            {"separator": "comma", "header_row": 1}, {"Timestamp": iso}, says="dates and times in column 'Timestamp'",
        ),
        "ISO times in quotes": LoggerFile(
            ("Timestamp,F,a\n" + table([f'"{text}"' for text in iso], f, a)).encode(),
            {"F": truth["F"], "a": truth["a"]}, {"separator": "comma", "header_row": 1}, {"Timestamp": iso},
            says="cells in quotes",
        ),
        "German date and time apart": LoggerFile(
            ("Datum;Uhrzeit;Kraft;Beschl\n" + "".join(
                f"{day};{hour};{row}\n" for day, hour, row in zip(
                    days, fine, table(f, a, separator=";", comma=True).splitlines(), strict=True))).encode(),
            {"Kraft": truth["F"], "Beschl": truth["a"]}, short, {"Datum": days, "Uhrzeit": fine},
            says="dates and times in columns 'Datum', 'Uhrzeit'",
        ),
        "texts behind the numbers": LoggerFile(
            ("F,State,Clock\n" + table(f, ["OK"] * N_ROWS, hours)).encode(), {"F": truth["F"]},
            {"separator": "comma", "header_row": 1}, {"State": ["OK"] * N_ROWS, "Clock": hours},
            says="texts in columns 'State', 'Clock'",
        ),
        "UTF-16 of a Windows logger": LoggerFile(
            ("t\tF\ta\r\n" + table(t, f, a, separator="\t", end="\r\n")).encode("utf-16"), truth,
            {"separator": "tab", "header_row": 1, "encoding": "utf-16"}, says="UTF-16",
        ),
        "UTF-16 without a byte order mark": LoggerFile(
            ("t\tF\ta\r\n" + table(t, f, a, separator="\t", end="\r\n")).encode("utf-16-le"), truth,
            {"separator": "tab", "header_row": 1, "encoding": "utf-16"}, says="UTF-16",
        ),
        "UTF-16, high byte first, without a byte order mark": LoggerFile(
            ("t\tF\ta\r\n" + table(t, f, a, separator="\t", end="\r\n")).encode("utf-16-be"), truth,
            {"separator": "tab", "header_row": 1, "encoding": "utf-16"}, says="UTF-16",
        ),
        "UTF-16 with decimal commas and a preamble": LoggerFile(
            ("Projekt: Fräse\r\n\r\nZeit\tKraft\tBeschl\r\n"
             + table(t, f, a, separator="\t", end="\r\n", comma=True)).encode("utf-16"),
            german, {"separator": "tab", "decimal": "comma", "header_row": 3, "encoding": "utf-16"}, says="UTF-16",
        ),
        "no names, decimal commas between blanks": LoggerFile(
            table(t, f, separator="   ", comma=True).encode(), {"1": truth["t"], "2": truth["F"]},
            {"separator": "blank", "decimal": "comma", "header_row": 0}, says="decimal commas",
        ),
        "no names below a preamble": LoggerFile(
            ("Datalogger 7\nserial 0815\n" + table(t, f, separator="\t")).encode(),
            {"1": truth["t"], "2": truth["F"]}, {"separator": "tab", "header_row": 0, "first_row": 3},
            says="2 rows above its numbers",
        ),
        "one column with decimal commas": LoggerFile(
            ("Kraft\n" + table(f, comma=True)).encode(), {"Kraft": truth["F"]},
            {"separator": "blank", "decimal": "comma", "header_row": 1}, says="decimal commas",
        ),
        "counts between semicolons with a preamble of commas": LoggerFile(
            ("Logger, 2 channels, 1 kHz\nn;raw\n"
             + table([str(i) for i in range(N_ROWS)], counts, separator=";")).encode(),
            {"n": list(range(N_ROWS)), "raw": numbers(counts)}, {"separator": "semicolon", "header_row": 2},
            says="1 row above its names",
        ),
        "names far above the numbers": LoggerFile(
            ("t;F\n\n\n" + table(t, f, separator=";")).encode(), {"t": truth["t"], "F": truth["F"]},
            {"separator": "semicolon", "header_row": 1, "first_row": 4}, says="rows between names and numbers",
        ),
    }  # fmt: skip
    return files | trace_files()


def trace_files() -> dict[str, LoggerFile]:
    """Return traces of drives: a column of times in front of each signal."""
    t, f, a = columns(2)
    slow = [f"{0.004 * i:.3f}" for i in range(N_ROWS // 2)]
    wide = [*slow, *[""] * (N_ROWS - len(slow))]
    current = [*f[: len(slow)], *[""] * (N_ROWS - len(slow))]
    milliseconds = [f"{0.2 * i:.1f}" for i in range(N_ROWS)]
    two = {"Time 1": numbers(t), "Torque": numbers(f), "Time 2": numbers(slow), "Current": numbers(f[: len(slow)])}
    same = {"Time 1": numbers(milliseconds), "r0080": numbers(f), "Time 2": numbers(milliseconds), "r0063": numbers(a)}
    return {
        "trace: equal names of times": LoggerFile(
            ("Time,Torque,Time,Current\n" + table(t, f, wide, current)).encode(), two
        ),
        "trace: units in brackets": LoggerFile(
            ("Time [ms];r0080;Time [ms];r0063\n" + table(milliseconds, f, milliseconds, a, separator=";")).encode(),
            same, units={"Time 1": "ms", "Time 2": "ms"},
        ),
        "trace: German, with units and a preamble": LoggerFile(
            ("Trace 1;Achse X\n\nZeit;Moment;Zeit;Strom\nms;Nm;ms;A\n"
             + table(t, f, wide, current, separator=";", comma=True)).encode("latin-1"),
            {"Zeit 1": two["Time 1"], "Moment": two["Torque"], "Zeit 2": two["Time 2"], "Strom": two["Current"]},
            {"separator": "semicolon", "decimal": "comma", "header_row": 3, "unit_row": 4},
            units={"Zeit 1": "ms", "Moment": "Nm", "Strom": "A"}, says="decimal commas",
        ),
    }  # fmt: skip


def twincat(
    *, separator: str = "\t", comma: bool = False, full: bool = False, unit: str = "Nm (Torque)", last: str = "",
    end_tag: bool = False, encoding: str = "utf-8", n_rows: int = N_ROWS,
) -> tuple[bytes, dict[str, list[float]]]:  # fmt: skip
    """Return an export of TwinCAT Scope of two sampling times (1 and 2 ms), and its truth."""
    _, f, a = columns(3, n_rows)
    start, n_slow = TWINCAT_START, n_rows // 2
    rows = {
        "Name": ["Name", "Torque", "Acc nut", "Name", "Position"],
        "SymbolComment": ["SymbolComment", "", "", "SymbolComment", ""],
        "Data-Type": ["Data-Type", "REAL64", "REAL64", "Data-Type", "REAL64"],
        "SampleTime[ms]": ["SampleTime[ms]", "1", "1", "SampleTime[ms]", "2"],
        "SymbolName": ["SymbolName", "MAIN.fTorque", "MAIN.fAcc", "SymbolName", "MAIN.fPos"],
        "Unit": ["Unit", unit, "(None)", "Unit", "mm (Length)"],
    }
    lines = [
        separator.join(("Name", "Scope Project")) + last,
        separator.join(("File", "C:\\scope\\export.csv")) + last,
        separator.join(("Starttime of export", str(start), "Montag, 2. Mai 2022", "15:56:24.376")) + last,
        separator.join(("Endtime of export", str(start + 10000 * n_rows), "Montag, 2. Mai 2022", "15:56:24.436"))
        + last,
        "", "", *(separator.join(cells) + last for cells in rows.values()), "",
    ]  # fmt: skip
    for i in range(n_rows):
        at, slow_at = (str(start + 10000 * i), str(start + 20000 * i)) if full else (str(i), str(2 * i))
        cells = [at, f[i], a[i]]
        if i < n_slow:
            cells += [slow_at, a[-1 - i]]
        elif i < n_rows - 5:
            cells += [" ", " "]
        row = separator.join(cells)
        lines.append((row.replace(".", ",") if comma else row) + last)
    content = "\r\n".join([*lines, *(["EOF"] if end_tag else [])]) + "\r\n"
    return content.encode(encoding), {
        "Time 1": [float(i) for i in range(n_rows)], "Torque": numbers(f), "Acc nut": numbers(a),
        "Time 2": [2.0 * i for i in range(n_slow)], "Position": numbers(a[::-1][:n_slow]),
    }  # fmt: skip


def lvm(
    *, of_x: str = "No", separator: str = "Tab", comma: bool = False, n_segments: int = 1, comments: bool = False,
    encoding: str = "utf-8", n_rows: int = N_ROWS, stated: int | None = None, special: bool = False,
) -> tuple[bytes, dict[str, list[list[float]]]]:  # fmt: skip
    """Return a LabVIEW measurement file, and for each channel the numbers of each segment."""
    sign, point = ("\t" if separator == "Tab" else ","), ("," if comma else ".")
    truth: dict[str, list[list[float]]] = {"Force": [], "Accélération": []}
    lines = ["LabVIEW Measurement", f"Writer_Version{sign}2", f"Reader_Version{sign}2", f"Separator{sign}{separator}",
             f"Decimal_Separator{sign}{point}", f"Multi_Headings{sign}Yes", f"X_Columns{sign}{of_x}",
             f"Time_Pref{sign}Absolute", f"Date{sign}2025/03/01", "***End_of_Header***", ""]  # fmt: skip
    for segment in range(n_segments):
        t, f, a = columns(10 + segment, n_rows)
        truth["Force"].append(numbers(f))
        truth["Accélération"].append(numbers(a))
        heads = {"Channels": ["2"], "Samples": [str(stated or n_rows)] * 2, "Date": ["2025/03/01"] * 2,
                 "Y_Unit_Label": ["N", "m/s^2"], "X_Dimension": ["Time", "Time"],
                 "X0": [f"0{point}0E+0"] * 2, "Delta_X": [f"2{point}0E-4"] * 2}  # fmt: skip
        for key, values in heads.items():
            spread = values if of_x != "Multi" or len(values) == 1 else [values[0], "", values[1]]
            lines.append(sign.join((key, *spread)))
        if special:
            lines += ["***Start_Special***", "Channels of another kind", "***End_Special***"]
        lines.append("***End_of_Header***")
        names = (
            ("X_Value", "Force", "X_Value", "Accélération") if of_x == "Multi" else ("X_Value", "Force", "Accélération")
        )
        lines.append(sign.join((*names, "Comment")))
        for i in range(n_rows):
            cells = {"No": ["", f[i], a[i]], "One": [t[i], f[i], a[i]], "Multi": [t[i], f[i], t[i], a[i]]}[of_x]
            row = sign.join(cells).replace(".", point)
            lines.append(f"{row}{sign}tap {i}" if comments and i % 7 == 0 else row)
        lines.append("")
    return "\r\n".join(lines).encode(encoding), truth
