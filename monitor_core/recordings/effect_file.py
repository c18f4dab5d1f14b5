"""Read effects that a user defines: a Python file with ``EFFECTS``.

.. code-block:: python

    from dataclasses import replace

    from monitor_core.effects import Effect, EffectParameter


    def _add(axis, values):
        bodies = replace(axis.bodies, rotor_inertia=axis.bodies.rotor_inertia + values["inertia_kg_m2"])
        return replace(axis, bodies=bodies)


    EFFECTS = (
        Effect(
            key="handwheel",
            name="Handwheel at the motor",
            physics="It turns with the rotor.",
            source="no source: a rigid body in rotation",
            parameters=(EffectParameter("inertia_kg_m2", "kg·m²", lower=0.0, upper=0.1, scale=1e-4),),
            add=_add,
        ),
    )

The file is run: it can do whatever its owner's account may do.

An effect may make an axis another one at each setting: ``replace(axis, by_setting=(*axis.by_setting, change))`` with
``change(axis, setting)``, where a setting has position, preload, payload_mass, temperature_deviation, excitation_level
and order; ``varying`` makes such effects of plain laws, and ``at_port`` those by which something swings on the rotor,
at the far end of the screw (``screw-end``) or under the bearings (``base``), or the screw bends (``screw``). What
``explain`` has described is written as these:

.. code-block:: python

    from monitor_core.effects import Form, Law, Variable, at_port, varying

    EFFECTS = (
        at_port("rotor"),
        varying("joints", "nut_stiffness", Law(Variable.EXCITATION, Form.LINEAR, reference=0.15, scale=0.405)),
    )
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from monitor_core.effects import Effect, Variation, port_of
from monitor_core.errors import MonitorCoreError, RecordingFormatError
from monitor_core.recordings.elements.files import naming, read_text


def read_effect_file(path: Path) -> tuple[Effect[Any], ...]:
    """Run a Python file and return the effects that it defines as ``EFFECTS``; the module's text shows one.

    Whether an effect fits an axis shows when it is added to one. ``RecordingFormatError`` if the file is no Python,
    fails as it is run, or ``EFFECTS`` is missing, empty or anything but effects with keys of their own: one sentence
    names the file.
    """
    text = read_text(path)
    namespace: dict[str, object] = {"__name__": path.stem, "__file__": str(path)}
    try:
        with naming(path.name):
            exec(compile(text, path.name, "exec"), namespace)  # noqa: S102 what the user gives is the user's own program
    except MonitorCoreError:
        raise
    except Exception as error:  # whatever the program of the user raises; its name tells him where to look
        raise RecordingFormatError(
            f"{path.name}: expected a Python file of effects; got {type(error).__name__}: {error}"
        ) from error
    if "EFFECTS" not in namespace:
        raise RecordingFormatError(f"{path.name}: expected a definition of EFFECTS, a tuple of effects; it is missing")
    effects = namespace["EFFECTS"]
    if not isinstance(effects, tuple) or not effects:
        raise RecordingFormatError(f"{path.name}: expected EFFECTS to be a tuple of at least one; got {effects!r:.60}")
    for number, effect in enumerate(effects, 1):
        if not isinstance(effect, Effect):
            raise RecordingFormatError(
                f"{path.name}: expected effects in EFFECTS; number {number} is of type {type(effect).__name__}"
            )
    keys = [effect.key for effect in effects]
    if len(set(keys)) < len(keys):
        raise RecordingFormatError(f"{path.name}: expected effects with different keys; got {', '.join(keys)}")
    return effects


def effect_file_text(effects: Iterable[Effect[Any]]) -> str:
    """Return effects made by ``varying`` and ``at_port`` of ``monitor_core.effects`` as a file that can be read.

    ``RecordingFormatError`` if one of them was made otherwise: what it does is known to its own file alone.
    """
    lines = ["from monitor_core.effects import Form, Law, Variable, at_port, varying", "", "EFFECTS = ("]
    for effect in effects:
        if (port := port_of(effect)) is not None:
            lines.append(f'    at_port("{port}"),')
            continue
        variation = effect.add
        if not isinstance(variation, Variation):
            raise RecordingFormatError(f"effects: expected such as vary by a law or swing; got {effect.key}")
        law = variation.law
        stated = f"reference={law.reference!r}, scale={law.scale!r}" + (f", knots={law.knots!r}" if law.knots else "")
        lines += [
            "    varying(",
            f'        "{variation.record}",',
            f'        "{variation.quantity}",',
            f"        Law(Variable.{law.variable.name}, Form.{law.form.name}, {stated}),",
            f'        key="{effect.key}",',
            f'        name="{effect.name}",',
            "    ),",
        ]
    return "\n".join([*lines, ")"]) + "\n"
