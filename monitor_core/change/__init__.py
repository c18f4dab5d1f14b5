"""Attribute a change of an axis at work against its own reference: which part of the drive changed, and how sure."""

from monitor_core.change.attribution import (
    ChangeAttribution as ChangeAttribution,
    TriedChange as TriedChange,
    attribute_change as attribute_change,
)
from monitor_core.change.cells import positions_of as positions_of
from monitor_core.change.reference_ratio import FEWEST_POSITIONS as FEWEST_POSITIONS
