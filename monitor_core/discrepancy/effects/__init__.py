"""The effects that a drive may have beyond its model: one module each, and the table of all of them."""

from monitor_core.discrepancy.effects.catalogue import DRIVE_EFFECTS, applicable_effects, with_effects
from monitor_core.discrepancy.effects.wrong_parameter import wrong_parameter, wrong_parameters

__all__ = ["DRIVE_EFFECTS", "applicable_effects", "with_effects", "wrong_parameter", "wrong_parameters"]
