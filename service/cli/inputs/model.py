"""Read a drive model, and what the commands share that work with one: their options, responses, tolerances."""

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from monitor_core.effects import DRIVE_EFFECTS
from monitor_core.models import DriveModel
from monitor_core.pipeline import AxisSettings
from monitor_core.recordings.effect_file import read_effect_file
from monitor_core.recordings.elements.files import naming
from monitor_core.recordings.model_file import read_model_file
from monitor_core.recordings.recognition import MODEL
from monitor_core.recordings.stated_tolerances import read_tolerances
from service.operations.foreign_file import foreign_format, read_foreign

# imported where they are needed: modes and simulate take no data
if TYPE_CHECKING:
    from monitor_core.discrepancy import SettingTolerances
    from monitor_core.fitting.axis import AxisDescription
    from monitor_core.measured_responses import SessionResponses
    from service.cli.inputs.data import Data


#: By name in files: of :class:`SettingTolerances` the field, and its unit over that of the file.
_FIELDS = {
    "position_tolerance_mm": ("position", 1e-3),
    "preload_tolerance": ("preload_share", 1.0),
    "gain_tolerance": ("gain_share", 1.0),
    "payload_tolerance_kg": ("payload", 1.0),
    "temperature_tolerance_k": ("temperature", 1.0),
}
effects_option = click.option(
    "--effects", "effects_path", type=click.Path(path_type=Path), metavar="FILE",
    help="Python file that defines EFFECTS, of your own, which the model may state besides those of the product. It is "
    "run.",
)  # fmt: skip
tolerance_option = click.option(
    "--tolerance", "tolerances", type=(click.Choice(list(_FIELDS)), click.FloatRange(min=0.0, min_open=True)),
    multiple=True, metavar="NAME X",
    help="Standard deviation to which settings are known, before what the data state: position_tolerance_mm (usually "
    "0.3), preload_tolerance (0.03 of its value), gain_tolerance (0.005 of that of a response), payload_tolerance_kg, "
    "temperature_tolerance_k (usually exactly). May be given several times.",
)  # fmt: skip
accelerometer_option = click.option(
    "--accelerometer",
    type=click.Choice(["table", "nut"]),
    help="Where that of a session sat; without it where the model explains the session better.",
)


class NumbersCommand(click.Command):
    """A command whose options take several numbers: ``--position-mm 250 500`` or ``--position-mm=250 500``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Repeat the option before each further number."""
        repeatable = {
            name
            for option in self.params
            if isinstance(option, click.Option) and option.multiple and option.nargs == 1
            for name in option.opts
        }
        return super().parse_args(ctx, list(_repeated(args, repeatable)))


def _repeated(args: list[str], repeatable: set[str]) -> Iterator[str]:
    option: str | None = None
    n_values = 0
    for word in args:
        name, equals, _ = word.partition("=")
        if name in repeatable:
            option, n_values = name, len(equals)  # --position-mm=300 has its first number already
        elif option is not None and (n_values == 0 or _is_number(word)):
            if n_values > 0:
                yield option
            n_values += 1
        else:
            option = None
        yield word


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def model_at(path: Path) -> Path:
    """Return the path of a drive model; any other file is refused."""
    foreign_format(path, MODEL)
    return path


def described_model(path: Path, effects_path: Path | None = None) -> tuple["AxisDescription", DriveModel]:
    """Read a model file and build the model; what keeps it from being built is a fault of the file."""
    own = () if effects_path is None else read_effect_file(effects_path)
    with naming(path.name):
        description = read_model_file(model_at(path))
        return description, description.build((*DRIVE_EFFECTS, *own))


def built_model(path: Path, effects_path: Path | None = None) -> DriveModel:
    """Return the model of a file; raises as :func:`described_model`."""
    return described_model(path, effects_path)[1]


def require_session(accelerometer: str | None, *, of_session: bool) -> None:
    """Refuse a stated place of an accelerometer for data that say it themselves."""
    if accelerometer is not None and not of_session:
        raise click.UsageError(
            "--accelerometer goes with a session; a set of frequency responses says it itself, peaks are of the table"
        )


def responses_of_data(data: "Data", settings: AxisSettings) -> "SessionResponses":
    """Return the averaged responses of a session, with progress; raises as :func:`responses_of_session`."""
    from monitor_core.measured_responses import responses_of_session  # noqa: PLC0415
    from service.cli.inputs.data import opened_session  # noqa: PLC0415

    with opened_session(data) as session:
        return responses_of_session(session, settings)


def tolerances_of(data: "Data", stated: Iterable[tuple[str, float]]) -> "SettingTolerances":
    """Return how well the settings of measurements are known: as stated here, or in the data, or as usual."""
    from monitor_core.discrepancy import SettingTolerances  # noqa: PLC0415

    known = {name: value for name, value in {**_of_data(data), **dict(stated)}.items() if value is not None}
    return SettingTolerances(**{_FIELDS[name][0]: value * _FIELDS[name][1] for name, value in known.items()})


def _of_data(data: "Data") -> Mapping[str, float | None]:
    if data.channel_map is not None:
        return data.channel_map.tolerances.attributes
    if not data.is_session and not data.is_frf_set:
        return {}
    return read_foreign(partial(read_tolerances, data.file), data.name)
