"""Attribute a change of an axis at work against its own reference: which part of the drive changed, and how sure."""

from monitor_core.change.attribution import ChangeAttribution, TriedChange, attribute_change
from monitor_core.change.cells import positions_of
from monitor_core.change.reference_ratio import FEWEST_POSITIONS

__all__ = ["FEWEST_POSITIONS", "ChangeAttribution", "TriedChange", "attribute_change", "positions_of"]
