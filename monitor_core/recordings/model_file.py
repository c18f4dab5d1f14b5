"""Read and write a drive model, TOML: family, parameters with units, what a fit may adjust, added effects.

.. code-block:: toml

    family = "lumped"                        # lumped | hybrid | receptance | transmission-line | motion

    [parameters]                             # SI; the unit ends the name
    table_mass_kg = 20.54

    [uncertain]                              # relative prior standard deviation of what a fit may adjust
    bearing_stiffness_n_per_m = 0.2

    [effects.far-bearing-stiffness]          # effects already part of the model, with their values
    stiffness_n_per_m = 3.8e7

Unknown entries are refused, and so is anything that is not a finite number where one belongs.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from monitor_core.effects import DRIVE_EFFECTS, MOTION_EFFECTS, with_effects
from monitor_core.effects.effect import Effect
from monitor_core.errors import OutsideValidityError, RecordingFormatError
from monitor_core.models.extended import AxisPhysics, ExtendedModel
from monitor_core.models.families import FAMILIES, build_model
from monitor_core.models.motion import FAMILY as MOTION
from monitor_core.models.motion import MotionModel, MotionParameters, MotionPhysics
from monitor_core.models.parameters import DriveParameters
from monitor_core.models.protocol import DriveModel
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.files import naming, read_text

_TABLES = ("parameters", "uncertain", "effects")
_NAME = re.compile(r"[A-Za-z0-9_.:-]+", re.ASCII)
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)


@dataclass(frozen=True, slots=True)
class DriveModelFile:
    """What a model file states, by the names of the file."""

    family: str
    parameters: Mapping[str, float]  # SI, by names that end with the unit
    uncertain: Mapping[str, float] = field(default_factory=dict)  # relative standard deviation [-]
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # by key; values by names with units

    def build(self, effects: Sequence[Effect[AxisPhysics]] = DRIVE_EFFECTS) -> DriveModel:
        """Return the model: that of the family, or with effects the extended drive with them added in their order.

        Parameters
        ----------
        effects : sequence of Effect
            What the keys of the file may mean: the table of the product, or with a user's own.

        Raises
        ------
        OutsideValidityError
            If an effect is unknown, or does not fit the axis or its values; if it is a motion model, which has no
            frequency response; or as :func:`build_model` says.
        """
        if self.family == MOTION:
            raise OutsideValidityError(
                "expected a drive with natural frequencies, of the family "
                f"{', '.join(family.name for family in FAMILIES)}; got a motion model, which is a rigid axis"
            )
        family_model = build_model(self.family, self.parameters)
        if not self.effects:
            return family_model
        return with_effects(ExtendedModel.of(family_model.parameters), self.effects, effects)

    def build_motion(self, effects: Sequence[Effect[MotionPhysics]] = MOTION_EFFECTS) -> MotionModel:
        """Return the rigid axis of a motion model, with its effects added in their order; as :meth:`build`.

        Raises
        ------
        OutsideValidityError
            If an effect is unknown, or does not fit the axis or its values; or if it is the model of a drive.
        """
        if self.family != MOTION:
            raise OutsideValidityError(f"expected a model of the family {MOTION}; got one of {self.family}")
        stated = MotionParameters.from_file_names(self.parameters, self.family)
        return with_effects(MotionModel.of(stated), self.effects, effects)


def read_model_file(path: Path) -> DriveModelFile:
    """Read a drive model; the module's text shows every entry.

    Parameters
    ----------
    path : Path
        A TOML file.

    Returns
    -------
    DriveModelFile
        Family and parameters fit each other, so that only an effect can keep it from being built.

    Raises
    ------
    RecordingFormatError
        If it is no TOML, or anything in it is missing, unknown, of the wrong type or out of range: one sentence names
        file and entry.
    """
    return parse_model(read_text(path), path.name)


def parse_model(text: str, where: str) -> DriveModelFile:
    """Read a drive model from TOML text; ``where`` names it in refusals. Raises as :func:`read_model_file`."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise RecordingFormatError(f"{where}: expected a drive model in TOML; {error}") from error
    return _from_document(document, where)


def model_file_text(model: DriveModelFile) -> str:
    """Return the model as TOML text; :func:`read_model_file` reads it back to the last bit.

    Raises
    ------
    RecordingFormatError
        If the record is not one that could be read back.
    """
    tables: dict[str, object] = {
        "family": model.family,
        "parameters": dict(model.parameters),
        "uncertain": dict(model.uncertain),
        "effects": {key: dict(values) for key, values in model.effects.items()},
    }
    _from_document(tables, "drive model")
    sections = [("parameters", model.parameters)]
    if model.uncertain:
        sections.append(("uncertain", model.uncertain))
    sections += [(f"effects.{_key(key)}", values) for key, values in model.effects.items()]
    lines = [f'family = "{model.family}"']
    for name, values in sections:
        lines += ["", f"[{name}]", *(f"{_key(entry)} = {float(value)!r}" for entry, value in values.items())]
    return "\n".join(lines) + "\n"


def write_model_file(path: Path, model: DriveModelFile) -> None:
    """Write a drive model; an existing file is replaced. Raises as :func:`model_file_text`."""
    path.write_text(model_file_text(model), encoding="utf-8")


def _from_document(document: Mapping[str, object], where: str) -> DriveModelFile:
    top = Fields(document, where)
    top.only({"family", *_TABLES})
    name, parameters = top.text("family"), _numbers(top.table("parameters"))
    with naming(f"{where}, family"):
        record = _parameters_of(name)
    with naming(f"{where} [parameters]"):
        record.from_file_names(parameters, name)
    effects = top.table("effects") if "effects" in top else Fields({}, where)
    return DriveModelFile(
        family=name,
        parameters=parameters,
        uncertain=_uncertain(top.table("uncertain"), parameters) if "uncertain" in top else {},
        effects={_require_name(key, effects): _numbers(effects.table(key)) for key in effects.values},
    )


def _parameters_of(family: str) -> type[DriveParameters]:
    records = {known.name: known.parameters for known in FAMILIES} | {MOTION: MotionParameters}
    if family not in records:
        raise OutsideValidityError(f"family must be one of {', '.join(records)}; got {family!r}")
    return records[family]


def _uncertain(fields: Fields, parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the shares; one of a value that is not stated, or is zero, would say nothing."""
    fields.only(set(parameters))
    shares = {name: fields.positive(name, "-") for name in fields.values}
    for name in shares:
        if parameters[name] == 0.0:
            raise RecordingFormatError(
                f"{fields.where}, {name}: expected a parameter that is not zero, since the uncertainty is a share of "
                "it; got 0 in [parameters]"
            )
    return shares


def _numbers(fields: Fields) -> dict[str, float]:
    return {_require_name(name, fields): fields.number(name, "SI") for name in fields.values}


def _require_name(name: str, fields: Fields) -> str:
    if not _NAME.fullmatch(name):
        raise RecordingFormatError(f"{fields.where}: expected a name of letters, digits and _ . : -; got {name!a}")
    return name


def _key(name: str) -> str:
    """Return a key as TOML writes it; names hold nothing that would need an escape."""
    return name if _BARE_KEY.fullmatch(name) else f'"{name}"'
