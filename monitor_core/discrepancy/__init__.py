"""Explain where simulation and measurement differ: which effects a model may lack, and which one it does lack.

``explain`` asks the whole question of a described axis: it compares, screens the effects, searches those that help,
judges what was found, and answers with an :class:`Explanation`.
"""

from monitor_core.discrepancy.description.variation import Place as Place
from monitor_core.discrepancy.explain_axis import (
    ExplainOptions as ExplainOptions,
    Measured as Measured,
    explain as explain,
    require_explainable as require_explainable,
)
from monitor_core.discrepancy.explanation import (
    Candidate as Candidate,
    Described as Described,
    DescribedAlternative as DescribedAlternative,
    Explanation as Explanation,
    FoundEffect as FoundEffect,
    FoundParameter as FoundParameter,
    GapPair as GapPair,
    Misfit as Misfit,
    MisfitMap as MisfitMap,
    MisfitPlace as MisfitPlace,
    NextStep as NextStep,
    Outcome as Outcome,
    RecordFault as RecordFault,
    Step as Step,
    StepEffect as StepEffect,
    StepKind as StepKind,
    Unfinished as Unfinished,
    Untested as Untested,
    UntestedReason as UntestedReason,
    WrongRecord as WrongRecord,
)
from monitor_core.discrepancy.screw_axis import AgainstScrew as AgainstScrew, Objection as Objection
from monitor_core.discrepancy.search.workspace import STRAINED as STRAINED
from monitor_core.discrepancy.verdict.classes import AMPLITUDE_LAW as AMPLITUDE_LAW, TIME_LAW as TIME_LAW
from monitor_core.fitting.conditions.groups import Dimension as Dimension, Extent as Extent
from monitor_core.fitting.conditions.settings import SettingTolerances as SettingTolerances
from monitor_core.fitting.evidence import VERY_STRONG as VERY_STRONG
