"""Read and write measured frequency responses of one axis under several conditions, ``*.frf.h5``.

Root attributes ``format`` = "preload-frf-set", ``version`` = 1. Each group ``/conditions/NNNN`` holds one response with
the noise of its lines (datasets ``frequency_hz``, ``response``, ``standard_deviation``) and the conditions it was
measured under; the attributes and their units are those of ``docs/reference/recordings.md``. What was excited and what
answers imply the unit of the response, so a wrong one is refused, never converted. Attributes that are not known here
are left alone.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from monitor_core.errors import RecordingFormatError
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.files import refusing
from monitor_core.recordings.elements.hdf5 import attributes, numbered_groups, open_hdf5
from monitor_core.recordings.frf_condition import TEMPERATURES, MeasuredResponse, read_condition, write_condition

if TYPE_CHECKING:
    import h5py

FORMAT = "preload-frf-set"
VERSION = 1
_ROOT_ATTRIBUTES = frozenset(("format", "version"))


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponseSet:
    """Measured responses of one axis, in the order of the file."""

    measured: tuple[MeasuredResponse, ...]

    @property
    def observations(self) -> tuple[FrequencyResponseObservation, ...]:
        """What an identification takes."""
        return tuple(measured.observation for measured in self.measured)


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponseSetReader:
    """An open file; see :func:`open_frf_set`."""

    conditions: tuple[str, ...]  # names of the groups, in order
    _group: "h5py.Group"
    _where: str
    _reference: float | None  # temperature that deviations are from, where the set states none [°C]

    def measured(self, condition: str) -> MeasuredResponse:
        """Read one condition by the name of its group."""
        where = f"{self._where} /conditions/{condition}"
        with refusing(where, "a readable frequency response"):
            return read_condition(self._group[condition], where, self._reference)


@contextmanager
def open_frf_set(path: Path) -> Iterator[FrequencyResponseSetReader]:
    """Open an FRF set and check its frame; a response is read when asked for.

    ``path``: a ``*.frf.h5`` file. Returned: valid inside the ``with`` block. ``RecordingFormatError`` if the file
    is no such set: one sentence says what was expected, what was got, and where.
    """
    with open_hdf5(path) as file:
        with refusing(path.name, f"a {FORMAT} file"):
            reader = _set_reader(file, path.name)
        yield reader


def read_frf_set(path: Path) -> FrequencyResponseSet:
    """Read an FRF set; raises as :func:`open_frf_set`.

    Returned: SI units. Of what is not stated, the preload is None and the payload and the deviation from the
    reference temperature are 0; an excitation level that is not stated counts as small signals.
    """
    with open_frf_set(path) as reader:
        return FrequencyResponseSet(tuple(reader.measured(name) for name in reader.conditions))


def write_frf_set(path: Path, responses: FrequencyResponseSet) -> None:
    """Write an FRF set; the same set gives the same bytes, whenever it is written.

    ``path``: usually ``*.frf.h5``; an existing file is replaced; ``responses``: at least one.
    ``RecordingFormatError`` if the set holds no response.
    """
    import h5py  # noqa: PLC0415  # file libraries are imported where they are needed

    if not responses.measured:
        raise RecordingFormatError(f"{path.name}: expected at least one condition; got none")
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": FORMAT, "version": VERSION})
        conditions = file.create_group("conditions")
        for number, measured in enumerate(responses.measured):
            write_condition(conditions.create_group(f"{number:04d}"), measured)


def _set_reader(file: "h5py.File", where: str) -> FrequencyResponseSetReader:
    root = attributes(file, _ROOT_ATTRIBUTES, f"{where} /")
    root.require_format(FORMAT, VERSION)
    conditions, temperatures = numbered_groups(file, "conditions", 4, TEMPERATURES, where)
    if not temperatures:
        raise RecordingFormatError(f"{where}: expected at least one condition; got none")
    return FrequencyResponseSetReader(tuple(temperatures), conditions, where, _reference_temperature(temperatures))


def _reference_temperature(temperatures: Mapping[str, Fields]) -> float | None:
    """Return the temperature that deviations are from where none is stated: the mean of the set [°C].

    Which reference is taken is without meaning as long as it is one for all; a set that mixes its own with this is
    refused.
    """
    stated = [fields for fields in temperatures.values() if "temperature_c" in fields]
    alone = [fields for fields in stated if "temperature_delta_c" not in fields]
    values = [fields.number("temperature_c", "°C") for fields in stated]
    if not alone or len(set(values)) == 1:
        return None
    if len(alone) < len(temperatures):
        raise RecordingFormatError(
            f"{alone[0].where}, temperature_delta_c: expected a deviation from the reference [K], because the "
            f"temperatures of the set differ ({min(values):g} to {max(values):g} °C) and not all stand alone; it is "
            "missing"
        )
    return sum(values) / len(values)
