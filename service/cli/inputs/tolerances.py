"""How well the settings of measurements are known: stated on the command line, or in the file, or as usual."""

from collections.abc import Callable, Mapping
from typing import TypeVar

import click

from monitor_core.discrepancy import SettingTolerances
from monitor_core.recordings.stated_tolerances import read_tolerances
from service.cli.inputs.raw import Data, DataKind

_Command = TypeVar("_Command", bound=Callable[..., None])

#: By name in files: of :class:`SettingTolerances` the field, and its unit over that of the file.
_FIELDS = {
    "position_tolerance_mm": ("position", 1e-3),
    "preload_tolerance": ("preload_share", 1.0),
    "gain_tolerance": ("gain_share", 1.0),
    "payload_tolerance_kg": ("payload", 1.0),
    "temperature_tolerance_k": ("temperature", 1.0),
}
_HELP = {
    "position_tolerance_mm": "positions are known [mm]; usually 0.3",
    "preload_tolerance": "preloads are known, of their value; usually 0.03",
    "gain_tolerance": "the gain of a response is known, of its value; usually 0.005",
    "payload_tolerance_kg": "payloads are known [kg]; usually exactly",
    "temperature_tolerance_k": "temperatures are known [K]; usually exactly",
}


def tolerance_options(command: _Command) -> _Command:
    """Add an option for each tolerance; their values come by the names that they have in files."""
    for name, words in reversed(_HELP.items()):
        option = click.option(
            f"--{name.replace('_', '-')}", name, type=click.FloatRange(min=0.0, min_open=True), metavar="X",
            help=f"Standard deviation to which {words}. Goes before what the data state.",
        )  # fmt: skip
        command = option(command)
    return command


def tolerances_of(data: Data, stated: Mapping[str, float | None]) -> SettingTolerances:
    """Return the tolerances of what the data are tagged with."""
    given = {name: value for name, value in stated.items() if value is not None}
    known = {name: value for name, value in {**_of_data(data), **given}.items() if value is not None}
    return SettingTolerances(**{_FIELDS[name][0]: value * _FIELDS[name][1] for name, value in known.items()})


def _of_data(data: Data) -> Mapping[str, float | None]:
    if data.channel_map is not None:
        return data.channel_map.tolerances.attributes
    return read_tolerances(data.file) if data.kind in (DataKind.FRF_SET, DataKind.SESSION) else {}
