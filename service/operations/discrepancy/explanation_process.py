"""An explanation in a process of its own, as it is stored."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from service.documents.explanation import explanation_document
from service.operations.discrepancy.explanation import ExplanationRequest, explain_measurements
from service.operations.own_process import in_own_process
from service.report import explanation_page


@dataclass(frozen=True, slots=True)
class Explained:
    """An explanation as it is stored."""

    document: dict[str, Any]  # the JSON of ``preload explain``
    page: str  # the report, one self-contained page of HTML


def explained(request: ExplanationRequest, subject: str, tell: Callable[[str], None]) -> Explained:
    """Explain measurements beside this process.

    Parameters
    ----------
    request : ExplanationRequest
    subject : str
        What was compared with what, as the title of the report says it.
    tell : callable
        As of :func:`in_own_process`.

    Raises
    ------
    MonitorCoreError
        As :func:`service.operations.discrepancy.explanation.explain_measurements`.
    """
    return in_own_process(partial(_explain, request, subject), tell)


def _explain(request: ExplanationRequest, subject: str, tell: Callable[[str], None]) -> Explained:
    explanation, model_text = explain_measurements(request, tell)
    return Explained(explanation_document(explanation, model_text), explanation_page(explanation, model_text, subject))
