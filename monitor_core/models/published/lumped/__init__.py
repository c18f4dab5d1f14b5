"""The lumped model: one spring, one mass, and the preload in the spring. Nguyen et al. (2018), Eqs. (1)–(8)."""

from monitor_core.models.published.lumped.feature import FeatureCoefficients, feature_coefficients
from monitor_core.models.published.lumped.model import LumpedModel
from monitor_core.models.published.lumped.parameters import LumpedParameters
from monitor_core.models.published.lumped.stiffness import (
    axial_stiffness,
    rotational_stiffness,
    shaft_axial_stiffness,
    shaft_torsional_stiffness,
)

__all__ = [
    "FeatureCoefficients",
    "LumpedModel",
    "LumpedParameters",
    "axial_stiffness",
    "feature_coefficients",
    "rotational_stiffness",
    "shaft_axial_stiffness",
    "shaft_torsional_stiffness",
]
