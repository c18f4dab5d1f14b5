"""Read universal files, data set 58 in text or binary (58b), through pyuff (extra ``uff``): time histories and FRFs.

Time histories are channels, complex FRFs (function type 4) are frequency responses; spectra are left out. Both carry
the first identification line of their data set; where these lines are empty or not distinct among the channels, or
among the responses, they are numbered "1", "2", ….
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import read_only, read_only_complex
from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recordings.elements.bounds import require_plausible_channels
from monitor_core.recordings.elements.files import refusing, require_file
from monitor_core.recordings.elements.units import unit_of
from monitor_core.recordings.raw.channel_time import time_of_step
from monitor_core.recordings.raw.channels import Channel, Channels, FrequencyResponse, native_samples

if TYPE_CHECKING:
    import pyuff

_TIME_RESPONSE, _FREQUENCY_RESPONSE = 1, 4  # function types of record 6
_COMPLEX = (5, 6)  # data types of the ordinate: single and double precision
_FUNCTION_TYPES = {0: "general", 1: "time response", 2: "auto spectrum", 3: "cross spectrum", 4: "FRF", 6: "coherence",
                   9: "power spectral density", 12: "spectrum"}  # fmt: skip
#: Most numbers in a line of text.
_IN_A_LINE = 6
#: Start or end of a data set: "    -1" alone on its line, or directly behind binary samples.
_DELIMITER = re.compile(rb"    -1(?= {74}|\r|\n|\Z)")
#: Factors of data set 164 this near 1 are SI.
_SI = 1e-6
_DIGITS = 6  # record 7 is of the format 3E13.5
_HERTZ = frozenset(("hz", "hertz", "1/s", "none", ""))
_SECONDS = frozenset(("s", "sec", "second", "seconds", "none", ""))  # record 8; time is in seconds by definition


#: Specific data types of records 8 and 9, by their unit of SI.
_MEASURES = {5: "K", 8: "m", 9: "N", 11: "m/s", 12: "m/s2", 13: "N", 15: "Pa"}
#: Powers of length and force in them, by which data set 164 brings them to SI.
_POWERS = {8: (1, 0), 9: (0, 1), 11: (1, 0), 12: (1, 0), 13: (0, 1), 15: (-2, 1)}


class _Header(TypedDict):
    """What pyuff reads from the header of a data set 58, as far as it is used."""

    id1: str
    func_type: int
    ord_data_type: int
    num_pts: int
    abscissa_spacing: int
    abscissa_min: float
    abscissa_inc: float
    abscissa_axis_units_lab: str
    ordinate_axis_units_lab: str
    orddenom_axis_units_lab: str
    ordinate_spec_data_type: int
    orddenom_spec_data_type: int


class _DataSet(_Header):
    x: npt.NDArray[np.float64]
    data: npt.NDArray[np.generic]


def read_channels(path: Path) -> Channels:
    """Read the time histories and frequency responses of a universal file; other functions are named as not read.

    The unit comes from the ordinate's label (of a response also from its denominator's), where that is empty from the
    factors to SI of data set 164, the sample rate from the
    abscissa's increment, the start from its first value. The date in the header has no zone, so it is not known when
    that was. ``RecordingFormatError`` if the file is damaged or cut off, holds neither, or if a header announces other
    than what is there; ``MissingReaderError`` if pyuff is not installed.
    """
    try:
        import pyuff  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise MissingReaderError(f"{path.name}: reading UFF needs pyuff; pip install pyuff") from error

    n_delimiters = len(_DELIMITER.findall(require_file(path).read_bytes()))
    if n_delimiters == 0 or n_delimiters % 2:
        raise RecordingFormatError(
            f"{path.name}: expected each data set of a universal file between two lines '    -1'; "
            f"got {n_delimiters} of them: the file is cut off or of another format"
        )
    with refusing(path.name, "a universal file"):
        file = pyuff.UFF(str(path))
        kinds = [int(kind) for kind in file.get_set_types()]
        headers = {i: file.read_sets(i, header_only=True) for i, kind in enumerate(kinds) if kind == 58}
        histories = [i for i, header in headers.items() if header["func_type"] == _TIME_RESPONSE]
        responses = [
            i
            for i, header in headers.items()
            if header["func_type"] == _FREQUENCY_RESPONSE and header["ord_data_type"] in _COMPLEX
        ]
        if not histories and not responses:
            got = _got(kinds, headers)
            raise RecordingFormatError(f"{path.name}: expected a time history or an FRF in data set 58; got {got}")
        require_plausible_channels(
            [(str(i + 1), int(headers[i]["num_pts"])) for i in (*histories, *responses)], path.name
        )
        units: Mapping[str, float] = next((file.read_sets(i) for i, kind in enumerate(kinds) if kind == 164), {})
        channels = []
        for i, name in zip(histories, _names(headers, histories), strict=True):
            where = f"{path.name}, {name}"
            _require_time_base(headers[i], where)
            channels.append(_channel(_data_set(file, i, where), name, units, where))
        found = []
        for i, name in zip(responses, _names(headers, responses), strict=True):
            where = f"{path.name}, {name}"
            found.append(_response(_data_set(file, i, where), name, units, where))
        left_out = [
            f"data set {i + 1} ({_FUNCTION_TYPES.get(header['func_type'], 'another function')})"
            for i, header in headers.items()
            if i not in histories and i not in responses
        ]
        return Channels(path.name, tuple(channels), tuple(found), left_out=tuple(left_out))


def _data_set(file: "pyuff.UFF", number: int, where: str) -> _DataSet:
    data_set: _DataSet = file.read_sets(number)
    n_points, values = data_set["num_pts"], data_set["data"]
    if 0 < values.size - n_points < _IN_A_LINE and not np.any(values[n_points:]):  # some programs fill up the last line
        data_set["data"], data_set["x"] = values[:n_points], data_set["x"][:n_points]
    if data_set["data"].size != n_points:
        raise RecordingFormatError(
            f"{where}: expected {n_points} samples as its header says; got {data_set['data'].size}"
        )
    return data_set


def _got(kinds: list[int], headers: dict[int, _Header]) -> str:
    if not headers:
        return f"data sets {', '.join(str(kind) for kind in kinds)}"
    functions = dict.fromkeys(header["func_type"] for header in headers.values())
    return ", ".join(f"function type {f} ({_FUNCTION_TYPES.get(f, 'other')})" for f in functions)


def _names(headers: dict[int, _Header], which: list[int]) -> list[str]:
    labels = [headers[i]["id1"].strip() for i in which]
    distinct = len(set(labels)) == len(labels) and not {"", "NONE"} & set(labels)
    return labels if distinct else [str(number) for number in range(1, len(labels) + 1)]


def _require_time_base(header: _Header, where: str) -> None:
    unit = header["abscissa_axis_units_lab"].strip()
    if header["abscissa_spacing"] != 1:
        raise RecordingFormatError(f"{where}: expected even spacing in time; got an uneven abscissa")
    if unit.lower() not in _SECONDS:
        raise RecordingFormatError(f"{where}: expected an abscissa in s; got {unit!r}")
    increment = header["abscissa_inc"]
    if not (np.isfinite(increment) and increment > 0.0):
        raise RecordingFormatError(f"{where}: expected a positive abscissa increment; got {increment} s")
    if header["ord_data_type"] not in (2, 4):
        raise RecordingFormatError(f"{where}: expected real ordinates (2 or 4); got type {header['ord_data_type']}")


def _channel(data_set: _DataSet, name: str, units: Mapping[str, float], where: str) -> Channel:
    return Channel(
        name=name,
        stored=native_samples(data_set["data"]),
        unit=_unit(data_set["ordinate_axis_units_lab"], data_set["ordinate_spec_data_type"], units, where),
        measures=_MEASURES.get(data_set["ordinate_spec_data_type"]),
        time=time_of_step(data_set["num_pts"], data_set["abscissa_inc"], _DIGITS, data_set["abscissa_min"]),
    )


def _response(data_set: _DataSet, name: str, units: Mapping[str, float], where: str) -> FrequencyResponse:
    unit = data_set["abscissa_axis_units_lab"].strip()
    if unit.lower() not in _HERTZ:
        raise RecordingFormatError(f"{where}: expected an abscissa in Hz; got {unit!r}")
    frequency = np.asarray(data_set["x"], np.float64)
    if frequency.size != data_set["num_pts"] or not np.all(np.diff(frequency) > 0.0):
        raise RecordingFormatError(f"{where}: expected {data_set['num_pts']} rising frequencies; got others")
    above, below = (_MEASURES.get(data_set[key]) for key in ("ordinate_spec_data_type", "orddenom_spec_data_type"))
    return FrequencyResponse(
        name=name,
        frequency=read_only(frequency),
        response=read_only_complex(data_set["data"]),
        response_unit=_unit(data_set["ordinate_axis_units_lab"], data_set["ordinate_spec_data_type"], units, where),
        reference_unit=_unit(data_set["orddenom_axis_units_lab"], data_set["orddenom_spec_data_type"], units, where),
        measures=None if above is None or below is None else f"({above})/({below})",
    )


def _unit(label: str, kind: int, units: Mapping[str, float], where: str) -> str | None:
    """Return the unit of a label, or else that of the file, whose numbers by a factor of data set 164 are SI."""
    stated = None if label.strip() in ("", "NONE") else label.strip()
    of_length, of_force = units.get("length", 1.0), units.get("force", 1.0)
    if not (math.inf > of_length > 0.0 and math.inf > of_force > 0.0):
        raise RecordingFormatError(
            f"{where}: expected positive factors to SI in data set 164; got {of_length} and {of_force}"
        )
    length, force = _POWERS.get(kind, (0, 0))
    factor = of_length**-length * of_force**-force
    if abs(factor - 1.0) < _SI:
        return stated
    of_file = f"{factor:.12f}".rstrip("0") + f" {_MEASURES[kind]}"
    labelled, in_si = unit_of(stated), unit_of(_MEASURES[kind])
    if labelled is not None and in_si is not None and labelled.is_same(in_si):
        raise RecordingFormatError(
            f"{where}: expected one unit; its label says {stated!r}, and data set 164 that numbers are in {of_file}"
        )
    return stated or of_file
