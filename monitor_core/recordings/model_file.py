"""Read and write a drive model, TOML: family, parameters with units, what a fit may adjust, added effects.

.. code-block:: toml

    family = "lumped"                        # lumped | hybrid | receptance | transmission-line | motion

    [parameters]                             # SI; the unit ends the name
    table_mass_kg = 20.54

    [uncertain]                              # relative prior standard deviation of what a fit may adjust
    bearing_stiffness_n_per_m = 0.2

    [effects.far-bearing-stiffness]          # effects already part of the model, with their values
    stiffness_n_per_m = 3.8e7

    [simulation.speed-loop]                  # of sessions without a machine: recording, friction, control
    proportional_gain_nms_per_rad = 1.5

Unknown entries are refused, and so is anything that is not a finite number where one belongs.
"""

import re
from collections.abc import Mapping
from pathlib import Path

from monitor_core.errors import OutsideValidityError, RecordingFormatError
from monitor_core.fitting.axis import AxisDescription
from monitor_core.models.families import FAMILIES
from monitor_core.models.generator.stated import stated_simulation
from monitor_core.models.motion import FAMILY as MOTION, MotionParameters
from monitor_core.models.parameters import DriveParameters
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.files import naming, parse_toml, read_text

_TABLES = ("parameters", "uncertain", "effects", "simulation")
_NAME = re.compile(r"[A-Za-z0-9_.:-]+", re.ASCII)
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)


def read_model_file(path: Path) -> AxisDescription:
    """Read a drive model from a TOML file; the module's text shows every entry.

    Family and parameters fit each other, so that only an effect can keep it from being built. ``RecordingFormatError``
    if it is no TOML, or anything in it is missing, unknown, of the wrong type or out of range: one sentence names file
    and entry.
    """
    return parse_model(read_text(path), path.name)


def parse_model(text: str, where: str) -> AxisDescription:
    """Read a drive model from TOML text; ``where`` names it in refusals. Raises as :func:`read_model_file`."""
    return _from_document(parse_toml(text, where, "a drive model"), where)


def model_file_text(model: AxisDescription) -> str:
    """Return the model as TOML text; :func:`read_model_file` reads it back to the last bit.

    ``RecordingFormatError`` if the record is not one that could be read back.
    """
    tables: dict[str, object] = {
        "family": model.family,
        "parameters": dict(model.parameters),
        "uncertain": dict(model.uncertain),
        "effects": {key: dict(values) for key, values in model.effects.items()},
        "simulation": {key: dict(values) for key, values in model.simulation.items()},
    }
    _from_document(tables, "drive model")
    sections = [("parameters", model.parameters)]
    if model.uncertain:
        sections.append(("uncertain", model.uncertain))
    sections += [(f"effects.{_key(key)}", values) for key, values in model.effects.items()]
    sections += [(f"simulation.{key}", values) for key, values in model.simulation.items()]
    lines = [f'family = "{model.family}"']
    for name, values in sections:
        lines += ["", f"[{name}]", *(f"{_key(entry)} = {float(value)!r}" for entry, value in values.items())]
    return "\n".join(lines) + "\n"


def write_model_file(path: Path, model: AxisDescription) -> None:
    """Write a drive model; an existing file is replaced. Raises as :func:`model_file_text`."""
    path.write_text(model_file_text(model), encoding="utf-8")


def _from_document(document: Mapping[str, object], where: str) -> AxisDescription:
    top = Fields(document, where)
    top.only({"family", *_TABLES})
    name, parameters = top.text("family"), _numbers(top.table("parameters"))
    with naming(f"{where}, family"):
        record = _parameters_of(name)
    with naming(f"{where} [parameters]"):
        record.from_file_names(parameters, name)
    effects, simulation = (
        {key: _numbers(tables.table(_require_name(key, tables))) for key in tables.values}
        for tables in (top.table(name) if name in top else Fields({}, where) for name in ("effects", "simulation"))
    )
    with naming(f"{where} [simulation]"):
        stated_simulation(simulation)
    return AxisDescription(
        family=name,
        parameters=parameters,
        uncertain=_uncertain(top.table("uncertain"), parameters) if "uncertain" in top else {},
        effects=effects,
        simulation=simulation,
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
