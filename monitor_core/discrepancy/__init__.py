"""Explain where simulation and measurement differ: which effects a model may lack, and which one it does lack.

``explain`` asks the whole question of a described axis: it compares, screens the effects, searches those that help,
judges what was found, and answers with an :class:`Explanation`.
"""

from monitor_core.discrepancy.description.variation import Place
from monitor_core.discrepancy.explain_axis import ExplainOptions, Measured, explain, require_explainable
from monitor_core.discrepancy.explanation import (
    Candidate,
    Described,
    DescribedAlternative,
    Explanation,
    FoundEffect,
    FoundParameter,
    GapPair,
    Misfit,
    MisfitMap,
    MisfitPlace,
    NextStep,
    Outcome,
    RecordFault,
    Step,
    StepEffect,
    StepKind,
    Unfinished,
    Untested,
    UntestedReason,
    WrongRecord,
)
from monitor_core.discrepancy.verdict.classes import AMPLITUDE_LAW, TIME_LAW
from monitor_core.fitting.conditions.groups import Dimension, Extent
from monitor_core.fitting.conditions.settings import SettingTolerances

__all__ = [
    "AMPLITUDE_LAW",
    "TIME_LAW",
    "Candidate",
    "Described",
    "DescribedAlternative",
    "Dimension",
    "ExplainOptions",
    "Explanation",
    "Extent",
    "FoundEffect",
    "FoundParameter",
    "GapPair",
    "Measured",
    "Misfit",
    "MisfitMap",
    "MisfitPlace",
    "NextStep",
    "Outcome",
    "Place",
    "RecordFault",
    "SettingTolerances",
    "Step",
    "StepEffect",
    "StepKind",
    "Unfinished",
    "Untested",
    "UntestedReason",
    "WrongRecord",
    "explain",
    "require_explainable",
]
