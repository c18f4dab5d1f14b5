r"""Parameters of any drive model as coordinates of a fit: decimal logarithms of those that are free.

Every parameter of the vocabulary is positive where it plays a part (stiffness, damping, mass, loss factor) and known
beforehand to decades or to a share of itself, so a fit moves :math:`\log_{10}` of it. Parameters go by their names in
files, which end with the unit; values are in SI.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.priors import relative_priors
from monitor_core.fitting.problem import Bounds
from monitor_core.models.families import build_model
from monitor_core.models.protocol import DriveModel

#: The joints of a drive, what a fit moves unless told otherwise, and between which values [SI]: a decade and more
#: beyond what the four papers state (bearings 1e7 to 5e8 N/m, nuts 7e7 to 9e8 N/m, couplings 20 to 3e4 N·m/rad,
#: dampers of 2e3 to 2e5 N·s/m and of 4e-3 to 4 N·m·s/rad, loss factor 0.05). A bracket may be as good as rigid.
JOINT_LIMITS: Mapping[str, tuple[float, float]] = {
    "bearing_stiffness_n_per_m": (1e6, 1e10),
    "far_bearing_stiffness_n_per_m": (1e6, 1e10),
    "bracket_stiffness_n_per_m": (1e6, 1e11),
    "nut_stiffness_n_per_m": (1e7, 1e10),
    "coupling_stiffness_nm_per_rad": (1.0, 1e6),
    "loss_factor": (1e-4, 0.5),
    "bearing_damping_ns_per_m": (10.0, 1e6),
    "far_bearing_damping_ns_per_m": (10.0, 1e6),
    "nut_damping_ns_per_m": (10.0, 1e7),
    "coupling_damping_nms_per_rad": (1e-5, 100.0),
}


@dataclass(frozen=True, slots=True, eq=False)
class ModelCoordinates:
    """Which parameters of a model are free, what is known of them beforehand, and the values of all."""

    family: str
    parameters: Mapping[str, float]  # SI, by names in files; the free ones where a fit starts and a prior is centred
    free: tuple[str, ...]  # of the parameters, in the order of the coordinates
    uncertain: Mapping[str, float] = field(default_factory=dict)  # relative prior standard deviation of free ones [-]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", dict(self.parameters))
        object.__setattr__(self, "uncertain", dict(self.uncertain))
        build_model(self.family, self.parameters)
        if not self.free:
            raise NotIdentifiableError("a fit needs a free parameter at least; got none")
        for name in self.free:
            if not self.parameters.get(name, 0.0) > 0.0:
                stated = self.parameters.get(name, "none")
                raise OutsideValidityError(f"{name} must be stated and positive to be free in a fit; got {stated}")
        if len(set(self.free)) != len(self.free):
            raise OutsideValidityError(f"a parameter must be freed once; got {', '.join(self.free)}")
        for name, share in self.uncertain.items():
            if name not in self.free:
                raise OutsideValidityError(f"a prior uncertainty must be of a free parameter; {name} is not free")
            if not (math.isfinite(share) and share > 0.0):
                raise OutsideValidityError(f"the relative prior uncertainty of {name} must be positive; got {share}")

    @property
    def start(self) -> FloatArray:
        """Coordinates of the model as stated, shape (n_parameters,)."""
        return np.asarray(np.log10([self.parameters[name] for name in self.free]))

    def values(self, coordinates: FloatArray) -> dict[str, float]:
        """Return all parameters with the free ones at the coordinates, as a model file states them.

        Parameters
        ----------
        coordinates : ndarray, shape (n_parameters,)
        """
        if np.shape(coordinates) != (len(self.free),):
            raise OutsideValidityError(
                f"coordinates must have shape ({len(self.free)},), one per free parameter; got {np.shape(coordinates)}"
            )
        free = {name: 10.0 ** float(x) for name, x in zip(self.free, coordinates, strict=True)}
        return {**self.parameters, **free}

    def build(self, coordinates: FloatArray) -> DriveModel:
        """Return the model at the coordinates.

        Parameters
        ----------
        coordinates : ndarray, shape (n_parameters,)

        Raises
        ------
        OutsideValidityError
            If a parameter is out of the range of its family.
        """
        return build_model(self.family, self.values(coordinates))

    def bounds(self, limits: Mapping[str, tuple[float, float]] | None = None) -> Bounds:
        """Return the bounds of the coordinates.

        Parameters
        ----------
        limits : mapping of str to (float, float), optional
            Lower and upper limit of free parameters, SI. By default, or where one is missing, :data:`JOINT_LIMITS`; a
            decade either way of the stated value for what is no joint or stands outside.
        """
        both = np.log10([(limits or {}).get(name) or self._default_limits(name) for name in self.free])
        return Bounds(both[:, 0], both[:, 1])

    @property
    def priors(self) -> FloatArray | None:
        """What is known beforehand, for :func:`monitor_core.fitting.priors.with_priors`."""
        return relative_priors(self.free, self.parameters, self.uncertain)

    def _default_limits(self, name: str) -> tuple[float, float]:
        stated = self.parameters[name]
        lower, upper = JOINT_LIMITS.get(name, (math.inf, 0.0))
        return (lower, upper) if lower <= stated <= upper else (stated / 10.0, stated * 10.0)


def joint_coordinates(
    family: str, parameters: Mapping[str, float], uncertain: Mapping[str, float] | None = None
) -> ModelCoordinates:
    """Free the joints that a model states, and whatever else it calls uncertain.

    Parameters
    ----------
    family : str
    parameters : mapping of str to float
        SI, by names in files. A joint that is not stated, or is zero, plays no part and stays as it is.
    uncertain : mapping of str to float, optional
        Relative prior standard deviation of what the fit may adjust. [-]

    Raises
    ------
    NotIdentifiableError
        If that frees nothing.
    OutsideValidityError
        If the family has no such parameter, or an uncertainty is of one that is not stated or zero.
    """
    uncertain = uncertain or {}
    joints = [name for name in JOINT_LIMITS if parameters.get(name, 0.0) > 0.0]
    others = [name for name in uncertain if name not in joints]
    return ModelCoordinates(family, parameters, (*joints, *others), uncertain)
