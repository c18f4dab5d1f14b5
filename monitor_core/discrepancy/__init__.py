"""Explain where simulation and measurement differ: which effects a model may lack, and which one it does lack.

``explain`` asks the whole question of a described axis: it compares, screens the effects, searches those that help,
judges what was found, and answers with an :class:`Explanation`.
"""

from monitor_core.discrepancy.description.quantities import Place
from monitor_core.discrepancy.explain_axis import ExplainOptions, Measured, explain, require_explainable
from monitor_core.discrepancy.explanation import (
    Candidate,
    Described,
    Explanation,
    FoundEffect,
    FoundParameter,
    GapPair,
    Misfit,
    MisfitMap,
    Outcome,
    RecordFault,
    WrongRecord,
)
from monitor_core.discrepancy.verdict.amplitude import AMPLITUDE_LAW
from monitor_core.discrepancy.verdict.classes import TIME_LAW
from monitor_core.fitting.conditions.settings import SettingTolerances

__all__ = [
    "AMPLITUDE_LAW",
    "TIME_LAW",
    "Candidate",
    "Described",
    "ExplainOptions",
    "Explanation",
    "FoundEffect",
    "FoundParameter",
    "GapPair",
    "Measured",
    "Misfit",
    "MisfitMap",
    "Outcome",
    "Place",
    "RecordFault",
    "SettingTolerances",
    "WrongRecord",
    "explain",
    "require_explainable",
]
