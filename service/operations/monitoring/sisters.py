"""Axes of one type lend a young one what it cannot know yet."""

from sqlalchemy.orm import Session

from monitor_core.trend import Prior, TrendStatus, prior_from
from service.errors import DocumentDamagedError
from service.operations.monitoring.axis_configuration import load_configuration
from service.operations.monitoring.intake.chart_state import load_state
from service.store.axes import list_axes
from service.store.tables import AxisRow


def prior_of_sisters(session: Session, axis: AxisRow) -> Prior | None:
    """Return what the healthy axes of the same stated type teach now; None without any."""
    axis_type = load_configuration(axis.configuration).axis_type
    if axis_type is None:
        return None
    learnt = []
    for sister in list_axes(session):
        if sister.id == axis.id or sister.state != TrendStatus.NORMAL:
            continue
        try:
            same = load_configuration(sister.configuration).axis_type == axis_type
            belief = load_state(sister.monitor_state).detector.learnt if same else None
        except DocumentDamagedError:  # it is told of on its own page, and keeps nobody else from learning
            continue
        if belief is not None:
            learnt.append(belief)
    return prior_from(learnt) if learnt else None


def sisters_of(session: Session, axis: AxisRow, most: int) -> list[AxisRow]:
    """Return other axes of the same stated type, so many at most, in order of name."""
    axis_type = load_configuration(axis.configuration).axis_type
    if axis_type is None:
        return []
    found: list[AxisRow] = []
    for sister in list_axes(session):
        try:
            same = sister.id != axis.id and load_configuration(sister.configuration).axis_type == axis_type
        except DocumentDamagedError:  # it is told of on its own page
            continue
        if same:
            found.append(sister)
        if len(found) == most:
            break
    return found
