"""Recognise a file by its content, and say in one sentence what to do with a file that is not of the kind expected."""

import codecs
import json
import re
import shlex
import zipfile
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings import motion_csv
from monitor_core.recordings.elements.files import listed, refusing, require_file, stem_of, utf16_codec
from monitor_core.recordings.elements.hdf5 import attributes, open_hdf5

SESSION, FRF_SET, MODAL_TABLE, MOTION_RECORD = "preload-session", "preload-frf-set", "modal-table", "motion-record"
CALIBRATION, MODEL, CHANNEL_MAP, EFFECTS = "preload-calibration", "preload-model", "channel-map", "effect-file"
UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class FileKind:
    """A kind of file: how a sentence calls it, and what can be done with it."""

    what: str
    ending: str | None = None  # usual ending of a raw file, by which its reader is found; None for all others
    advice: str = ""  # what to do with a file that no command takes
    columns: str = ""  # of a table of ours
    starts: tuple[bytes, ...] = ()  # how a file begins, where the format has a signature

    @property
    def wanted(self) -> str:
        """What a sentence calls it that asks for one."""
        return f"{self.what} ({self.columns})" if self.columns else self.what


_SAVE = "export the measurement as CSV, TDMS, MAT or another format that is read"
_UNPACK = "unpack it and give the file that is inside"

#: Every format that is recognised, by its name in a report.
KINDS: dict[str, FileKind] = {
    SESSION: FileKind("a session"),
    FRF_SET: FileKind("a set of frequency responses"),
    MODAL_TABLE: FileKind("a modal table", ".csv", columns="position_mm,frequency_hz"),
    MOTION_RECORD: FileKind("a motion record", ".csv", columns="time_s,position_m,force_n or torque_nm"),
    CALIBRATION: FileKind("a calibration"),
    MODEL: FileKind("a drive model in TOML"),
    CHANNEL_MAP: FileKind("a channel map"),
    EFFECTS: FileKind("a Python file"),
    "tdms": FileKind("a TDMS file of LabVIEW", ".tdms", starts=(b"TDSm",)),
    "uff58": FileKind("a universal file (UFF)", ".uff", starts=(b"    -1",)),
    "mat": FileKind("a MATLAB file", ".mat", starts=(b"MATLAB",)),
    "npz": FileKind("a NumPy archive", ".npz"),
    "npy": FileKind("a NumPy array", ".npy", starts=(b"\x93NUMPY",)),
    "wav": FileKind("a WAV recording", ".wav"),
    "mdf4": FileKind("a measurement file (MDF)", ".mf4", starts=(b"MDF     ", b"UnFinMF ")),
    "parquet": FileKind("a Parquet table", ".parquet", starts=(b"PAR1",)),
    "xlsx": FileKind("an Excel workbook (XLSX)", ".xlsx"),
    "lvm": FileKind("a LabVIEW measurement file (LVM)", ".lvm", starts=(b"LabVIEW Measurement",)),
    "csv": FileKind("a text with other columns", ".csv"),
    "hdf5": FileKind("an HDF5 file of another program", ".h5"),
    "json": FileKind("a JSON document of another kind"),
    "ide": FileKind(
        "an IDE recording of an enDAQ sensor",
        advice="export it as CSV or MAT with enDAQ Lab, or save what endaq.ide.to_pandas makes of it as CSV or Parquet",
        starts=(b"\x1aE\xdf\xa3",),
    ),
    "svdx": FileKind(
        "a recording of TwinCAT Scope (SVDX, SVB)", advice="export it as CSV or TDMS with TwinCAT Scope View"
    ),
    "tdms-index": FileKind(
        "the index of a TDMS file", advice="give the *.tdms file that it belongs to", starts=(b"TDSh",)
    ),
    "docx": FileKind("a Word document", advice=_SAVE),
    "pptx": FileKind("a PowerPoint presentation", advice=_SAVE),
    "ods": FileKind("an OpenDocument file", advice="save the table as CSV or XLSX"),
    "xls": FileKind(
        "an old Office file (such as XLS)",
        advice="save the table as XLSX or CSV",
        starts=(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1",),
    ),
    "pdf": FileKind("a PDF document", advice=_SAVE, starts=(b"%PDF",)),
    "zip": FileKind("a ZIP archive", advice=_UNPACK),
    "gzip": FileKind("a file packed with gzip", advice=_UNPACK, starts=(b"\x1f\x8b",)),
    "bzip2": FileKind("a file packed with bzip2", advice=_UNPACK, starts=(b"BZh",)),
    "xz": FileKind("a file packed with xz", advice=_UNPACK, starts=(b"\xfd7zXZ\x00",)),
    "zstd": FileKind("a file packed with zstd", advice=_UNPACK, starts=(b"\x28\xb5\x2f\xfd",)),
    "7z": FileKind("a 7z archive", advice=_UNPACK, starts=(b"7z\xbc\xaf\x27\x1c",)),
    "rar": FileKind("a RAR archive", advice=_UNPACK, starts=(b"Rar!\x1a\x07",)),
    "png": FileKind("a PNG picture", advice=_SAVE, starts=(b"\x89PNG\r\n\x1a\n",)),
    "jpeg": FileKind("a JPEG picture", advice=_SAVE, starts=(b"\xff\xd8\xff",)),
    "gif": FileKind("a GIF picture", advice=_SAVE, starts=(b"GIF8",)),
    "flac": FileKind("a FLAC recording", advice="save it as WAV", starts=(b"fLaC",)),
    "ogg": FileKind("an Ogg recording", advice="save it as WAV", starts=(b"OggS",)),
    "mp3": FileKind("an MP3 recording, whose samples are not those that were measured", advice=_SAVE, starts=(b"ID3",)),
    "sqlite": FileKind("an SQLite database", advice=_SAVE, starts=(b"SQLite format 3\x00",)),
    "arrow": FileKind("an Arrow or Feather table", advice="save it as Parquet or CSV", starts=(b"ARROW1", b"FEA1")),
    "pickle": FileKind(
        "a Python pickle, which could run a program",
        advice="save the arrays with numpy.savez",
        starts=(b"\x80\x04\x95", b"\x80\x05\x95"),
    ),
    "html": FileKind("an HTML page", advice=_SAVE),
    "xml": FileKind("an XML document", advice=_SAVE),
}

#: MATLAB files of version 4 have no signature, universal files may have lines in front of theirs.
_WITHOUT_SIGNATURE = {".mat": "mat", ".uff": "uff58", ".unv": "uff58", ".svdx": "svdx", ".svb": "svdx"}
#: Endings of files that are no text, whatever is in them.
_NEVER_TEXT = {".mat": "mat", ".tdms": "tdms", ".mf4": "mdf4", ".npy": "npy", ".npz": "npz", ".wav": "wav",
               ".parquet": "parquet", ".xlsx": "xlsx"}  # fmt: skip
_ROW_OF_NUMBERS = re.compile(r"^[ \t]*[+-]?\d[\d.,eE+-]*[ \t]*[;,\t ][ \t]*[+-]?\d[^\n]*\r?$", re.MULTILINE)
_HDF5 = b"\x89HDF\r\n\x1a\n"
_ZIP = b"PK"
_RIFF = (b"RIFF", b"RIFX", b"RF64")
#: What only a drive model has. Looked for in the text, so that a model that is no TOML is still judged as a model.
_DRIVE_MODEL = re.compile(r"""^\s*(["']?family["']?\s*=|\[(parameters|uncertain|effects)\b)""", re.MULTILINE)
_OF_CALIBRATION = re.compile(r'"(format|coefficients)"')
#: How columns of a modal table begin, besides the frequency: a table of frequencies alone may be a response.
_OF_MODAL_TABLE = ("position", "preload", "mode", "damping", "n_readings", "payload", "temperature", "started_at")
_OF_TEXTS = (".csv", ".lvm")
#: Endings that a text has only by mistake.
_BY_ENDING = {kind.ending: name for name, kind in KINDS.items() if kind.ending not in (None, ".h5", *_OF_TEXTS)}
_TEXT_MEMBERS = frozenset(b"\t\n\f\r\x1b")
_HEAD = 65536  # a format shows within so many bytes


def format_of(path: Path) -> str:
    """Recognise a file by its content without reading all of it.

    The format is called as in a report: ``preload-session``, ``preload-frf-set``, ``modal-table``, ``motion-record``,
    ``preload-model``, ``csv`` for other columns of text, ``docx`` …; :data:`KINDS` lists all. ``RecordingFormatError``
    if there is no such file, or its content is none of these.
    """
    with require_file(path).open("rb") as stream:
        head = stream.read(_HEAD)
    if head.startswith(_HDF5):
        return _format_of_hdf5(path, head)
    if head.startswith(_ZIP):
        return _format_of_zip(path)
    if head.startswith(_RIFF) and head[8:12] == b"WAVE":
        return "wav"
    for name, kind in KINDS.items():
        if head.startswith(kind.starts):
            return name
    text = _text(head)
    if text is not None and (own := path.suffix.lower()) in _NEVER_TEXT and _ROW_OF_NUMBERS.search(text):
        raise RecordingFormatError(
            f"{path.name}: expected {KINDS[_NEVER_TEXT[own]].what} as its name says; got text with rows of numbers: "
            f"name it {path.stem}.csv"
        )
    if (by_name := _WITHOUT_SIGNATURE.get(path.suffix.lower())) is not None:
        return by_name
    if text is None:
        begins = " ".join(f"{byte:02x}" for byte in head[:8])
        raise RecordingFormatError(
            f"{path.name}: expected a recording in a known format; got bytes that are neither text nor any of them "
            f"(it begins with {begins})"
        )
    return _format_of_text(path, text)


def require_format(path: Path, *expected: str) -> str:
    """Return the format of a file if it is one of those expected.

    ``RecordingFormatError`` if it is another one: the sentence names what was expected, what the file is, and the next
    step with it.
    """
    got = format_of(path)
    if got in expected:
        return got
    wanted = listed([KINDS[name].wanted for name in expected])
    advice = _advice(path.name, got, expected)
    raise RecordingFormatError(f"{path.name}: expected {wanted}; got {KINDS[got].what}{advice and f': {advice}'}")


def raw_ending(path: Path, known: Collection[str]) -> str:
    """Return the ending by which the reader of a raw file is found, whatever the file's name ends in.

    ``known`` are the endings that have a reader. ``RecordingFormatError`` if the file is no raw file, or of a format
    that has no reader.
    """
    got = format_of(path)
    kind = KINDS[got]
    own = path.suffix.lower()
    if kind.ending in _OF_TEXTS and own in known and own not in _BY_ENDING:
        return own
    if kind.ending in known:
        return str(kind.ending)
    advice = "" if is_raw(got) else _advice(path.name, got, ())
    endings = ", ".join(known)
    raise RecordingFormatError(
        f"{path.name}: expected a raw file ({endings}); got {kind.what}{advice and f': {advice}'}"
    )


def is_raw(name: str) -> bool:
    """Tell whether a format is that of raw files, whose channels mean nothing without a channel map."""
    return KINDS[name].ending is not None and name not in (MODAL_TABLE, MOTION_RECORD)


def _advice(name: str, got: str, expected: tuple[str, ...]) -> str:
    """Return the next step with a file that is not what a command takes; empty if nothing can be said."""
    shown, stem = shlex.quote(name), shlex.quote(stem_of(name))
    makes_calibration = CALIBRATION in expected and got in (SESSION, MODAL_TABLE)
    if makes_calibration:
        return f"preload calibrate {shown} --out {stem}.calibration.json makes a calibration of it"
    if expected == (CHANNEL_MAP,) and is_raw(got):
        return f"preload check {shown} --write-map {stem}.toml writes a channel map for it"
    if is_raw(got):
        return (
            f"preload check {shown} --write-map {stem}.toml writes a channel map for it, with which preload import "
            f"{shown} --map {stem}.toml --out {stem}.session.h5 makes a session of it"
        )
    return KINDS[got].advice or {
        SESSION: f"preload check {shown} says which commands take it",
        FRF_SET: "preload identify and preload explain take it",
        MODAL_TABLE: "preload calibrate, estimate, identify and explain take it",
        MOTION_RECORD: "preload explain takes it, with a model of family motion",
        CALIBRATION: "preload estimate takes it as --calibration, preload calibrate as --prior",
        MODEL: "preload modes and preload simulate take it, preload identify as --model, preload explain as --baseline",
        CHANNEL_MAP: "preload import takes it as --map",
        EFFECTS: "preload explain takes effects as --effects",
    }.get(got, "")


def _text(head: bytes) -> str | None:
    """Return the beginning of a file as text, or None if it is none; a letter cut in two at the end is left out."""
    if (codec := utf16_codec(head)) is not None:
        text = head[: len(head) // 2 * 2].decode(codec, "replace")
        return None if "\x00" in text else text
    if b"\x00" in head:
        return None
    try:
        return codecs.getincrementaldecoder("utf-8-sig")().decode(head)
    except UnicodeDecodeError:  # a table of an old program in the letters of its country, or no text at all
        is_text = all(byte >= 32 or byte in _TEXT_MEMBERS for byte in head)
        return head.decode("latin-1") if is_text else None


def _format_of_text(path: Path, text: str) -> str:
    text = text.lstrip()
    if text.startswith("{"):
        return _format_of_json(path, text)
    suffix = path.suffix.lower()
    if suffix == ".toml":
        return MODEL if _DRIVE_MODEL.search(text) else CHANNEL_MAP
    if suffix == ".py":
        return EFFECTS
    start = text[:200].lower()
    if start.startswith(("<!doctype html", "<html")):
        return "html"
    if start.startswith("<?xml"):
        return "xml"
    # letters in a file with the name of another format are what is left of one that is damaged
    return _BY_ENDING.get(suffix) or _format_of_columns(text)


def _format_of_json(path: Path, head: str) -> str:
    """Tell a calibration, or one that is damaged, from a document that is whole and has nothing of it."""
    if _OF_CALIBRATION.search(head) or path.stat().st_size > _HEAD:
        return CALIBRATION
    try:
        json.loads(head)
    except (ValueError, RecursionError):
        return CALIBRATION
    return "json"


def _format_of_columns(text: str) -> str:
    columns = [cell.strip().lower() for cell in text.partition("\n")[0].replace(";", ",").split(",")]
    if motion_csv.is_motion_header(columns):
        return MOTION_RECORD
    has_frequency = any(cell.startswith("frequency") for cell in columns)
    return MODAL_TABLE if has_frequency and any(cell.startswith(_OF_MODAL_TABLE) for cell in columns) else "csv"


def _format_of_zip(path: Path) -> str:
    """Tell the archives of Office and NumPy from others by what they hold; a damaged one by its name, or as NumPy's."""
    try:
        with refusing(path.name, "an archive"), zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except RecordingFormatError:
        return {".xlsx": "xlsx", ".docx": "docx", ".pptx": "pptx", ".ods": "ods", ".zip": "zip"}.get(
            path.suffix.lower(), "npz"
        )
    for folder, name in (("xl/", "xlsx"), ("word/", "docx"), ("ppt/", "pptx")):
        if any(member.startswith(folder) for member in names):
            return name
    if "mimetype" in names and "content.xml" in names:
        return "ods"
    return "npz" if all(member.endswith(".npy") for member in names) else "zip"


def _format_of_hdf5(path: Path, head: bytes) -> str:
    """Name the format of an HDF5 file; one that is damaged or states none is judged by its name and its groups.

    Ours state it near their beginning, where it is seen without opening the file, for which all of it is searched.
    """
    stated = [name for name in (SESSION, FRF_SET) if name.encode() in head]
    if len(stated) == 1:
        return stated[0]
    groups: frozenset[str] = frozenset()
    try:
        with open_hdf5(path) as file, refusing(path.name, "a readable format"):
            groups = frozenset(file)
            name = attributes(file, frozenset(("format",)), path.name).text("format")
    except RecordingFormatError:
        name = ""
    if name in (SESSION, FRF_SET):
        return name
    if path.suffix.lower() == ".mat":
        return "mat"
    if "conditions" in groups or path.name.lower().endswith(".frf.h5"):
        return FRF_SET
    foreign = groups and "windows" not in groups and not path.name.lower().endswith(".session.h5")
    return "hdf5" if foreign else SESSION
