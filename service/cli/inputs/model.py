"""Read a drive model from a file, and options that take several numbers, for ``modes`` and ``simulate``."""

from collections.abc import Iterator
from pathlib import Path

import click

from monitor_core.effects import DRIVE_EFFECTS
from monitor_core.models import DriveModel
from monitor_core.recordings.effect_file import read_effect_file
from monitor_core.recordings.elements.files import naming
from monitor_core.recordings.model_file import read_model_file
from service.cli.inputs.formats import model_at


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


effects_option = click.option(
    "--effects", "effects_path", type=click.Path(path_type=Path), metavar="FILE",
    help="Python file that defines EFFECTS, of your own, which the model may state besides those of the product. It is "
    "run.",
)  # fmt: skip


def built_model(path: Path, effects_path: Path | None = None) -> DriveModel:
    """Read a model file and build the model; what keeps it from being built is a fault of the file."""
    own = () if effects_path is None else read_effect_file(effects_path)
    with naming(path.name):
        return read_model_file(model_at(path)).build((*DRIVE_EFFECTS, *own))


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
