"""Explain where simulation and measurement differ: compare, search the missing effects, judge, answer.

``explain`` asks the whole question of a described axis.
"""

from monitor_core.discrepancy.explanation import Explanation, Outcome
from monitor_core.discrepancy.front import ExplainOptions, Measured, explain, require_explainable

__all__ = ["ExplainOptions", "Explanation", "Measured", "Outcome", "explain", "require_explainable"]
