r"""Free parameters of a drive as coordinates of a fit: decimal logarithms of their values.

Every parameter of the vocabulary is positive where it plays a part (stiffness, damping, mass, loss factor) and known
beforehand to decades or to a share of itself. So a fit moves :math:`\log_{10}` of it: bounds are decades, steps are
factors, and a standard uncertainty *u* of a coordinate is one of :math:`u \ln 10`, relative, of the parameter.
Parameters go by their names in files, which end with the unit; values are in SI.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects import DRIVE_EFFECTS, Effect, with_effects
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.problem import Bounds, FreeParameter, positive_parameter, stated_priors
from monitor_core.models.extended import AxisPhysics, ExtendedModel
from monitor_core.models.families import build_model, family_named
from monitor_core.models.parameters import DriveParameters, fields_by_name
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
#: A parameter whose slopes are below this share of the largest plays no part: so much is rounding of the derivatives.
#: One that plays too small a part is for :func:`~monitor_core.identification.identifiability.assess` to name. [-]
_FLAT = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class FreeParameters:
    """Which parameters of a drive are free, what is known of them beforehand, and the values of all.

    Coordinates have the shape (n_parameters,), a Jacobian has (n_residuals, n_parameters).
    """

    family: str
    parameters: Mapping[str, float]  # SI, by names in files; the free ones where a fit starts and a prior is centred
    free: tuple[str, ...]  # of the parameters, in the order of the coordinates
    uncertain: Mapping[str, float] = field(default_factory=dict)  # relative prior standard deviation of free ones [-]
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # of the drive, which stay as stated
    table: Sequence[Effect[AxisPhysics]] = DRIVE_EFFECTS  # what their keys may mean
    stated: DriveParameters = field(init=False)  # the record of the family
    coordinates: tuple[FreeParameter, ...] = field(init=False)  # what the fit moves, in order
    _fields: tuple[str, ...] = field(init=False)  # of the record, for each of them

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", dict(self.parameters))
        object.__setattr__(self, "uncertain", dict(self.uncertain))
        object.__setattr__(self, "stated", build_model(self.family, self.parameters).parameters)
        fields = fields_by_name(type(self.stated))
        object.__setattr__(self, "_fields", tuple(fields.get(name, name) for name in self.free))
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
        moved = (
            positive_parameter(name, self.parameters[name], self.uncertain.get(name, math.inf)) for name in self.free
        )
        object.__setattr__(self, "coordinates", tuple(moved))

    @property
    def start(self) -> FloatArray:
        """Coordinates of the drive as stated, shape (n_parameters,)."""
        return np.array([parameter.prior.estimate for parameter in self.coordinates])

    def values(self, coordinates: FloatArray) -> dict[str, float]:
        """Return all parameters with the free ones at the coordinates, as a model file states them."""
        return {**self.parameters, **self._free_values(coordinates)}

    def record(self, coordinates: FloatArray) -> DriveParameters:
        """Return the family's record at the coordinates; raises OutsideValidityError out of the range of the family."""
        values = self._free_values(coordinates).values()
        return replace(self.stated, **dict(zip(self._fields, values, strict=True)))

    def model(self, coordinates: FloatArray) -> DriveModel:
        """Return the model at the coordinates: the family's, or with effects the extended drive.

        Raises as :meth:`record`, and OutsideValidityError if an effect is unknown, or does not fit drive or values.
        """
        if self.effects:
            return with_effects(ExtendedModel.of(self.record(coordinates)), self.effects, self.table)
        return family_named(self.family).model(self.record(coordinates))

    def bounds(self, limits: Mapping[str, tuple[float, float]] | None = None) -> Bounds:
        """Return the bounds of the coordinates, from lower and upper limits of free parameters in SI.

        By default, or where one is missing, these are :data:`JOINT_LIMITS`; a decade either way of the stated value for
        what is no joint or stands outside.
        """
        both = np.log10([(limits or {}).get(name) or self._default_limits(name) for name in self.free])
        return Bounds(both[:, 0], both[:, 1])

    @property
    def priors(self) -> FloatArray | None:
        """What is known beforehand, for :func:`monitor_core.fitting.problem.with_priors`."""
        return stated_priors(self.coordinates) if self.uncertain else None

    def unseen(self, jacobian: FloatArray) -> tuple[str, ...]:
        """Return the free parameters that no datum moves with, by the Jacobian at the drive as stated."""
        slopes: FloatArray = np.linalg.norm(jacobian, axis=0)
        return tuple(name for name, slope in zip(self.free, slopes, strict=True) if slope <= _FLAT * slopes.max())

    def require_seen(self, jacobian: FloatArray) -> None:
        """Raise NotIdentifiableError if no datum moves with a free parameter without a prior, by the same Jacobian."""
        for name in self.unseen(jacobian):
            if name not in self.uncertain:
                raise NotIdentifiableError(
                    f"{name} moves no datum and has no prior uncertainty; measure what depends on it, or do not free it"
                )

    def require_enough(self, n_data: int, what: str) -> None:
        """Raise NotIdentifiableError without a datum, or with fewer than free parameters; a prior stands for one."""
        needed = len(self.free) - len(self.uncertain)
        if not n_data or n_data < needed:
            raise NotIdentifiableError(
                f"{len(self.free)} free parameters, {len(self.uncertain)} of them with a prior, need {max(needed, 1)} "
                f"{what} at least; got {n_data}; measure at more positions or free fewer"
            )

    def _free_values(self, coordinates: FloatArray) -> dict[str, float]:
        if np.shape(coordinates) != (len(self.free),):
            raise OutsideValidityError(
                f"coordinates must have shape ({len(self.free)},), one per free parameter; got {np.shape(coordinates)}"
            )
        moved = zip(self.coordinates, coordinates.tolist(), strict=True)
        return {parameter.name: parameter.transform.value(x) for parameter, x in moved}

    def _default_limits(self, name: str) -> tuple[float, float]:
        stated = self.parameters[name]
        lower, upper = JOINT_LIMITS.get(name, (math.inf, 0.0))
        return (lower, upper) if lower <= stated <= upper else (stated / 10.0, stated * 10.0)


def is_spring(name: str) -> bool:
    """Tell a spring, or a mass, from what damps, by its name in files."""
    return "damping" not in name and name != "loss_factor"


def free_joints(
    family: str, parameters: Mapping[str, float], uncertain: Mapping[str, float] | None = None
) -> FreeParameters:
    """Free the joints that a model states, and whatever else is uncertain, by relative standard deviations [-].

    A joint that is not stated, or is zero, plays no part and stays as it is. Raises NotIdentifiableError if that frees
    nothing; OutsideValidityError if the family has no such parameter, or an uncertainty is of one that is not stated or
    zero.
    """
    uncertain = uncertain or {}
    joints = [name for name in JOINT_LIMITS if parameters.get(name, 0.0) > 0.0]
    others = [name for name in uncertain if name not in joints]
    return FreeParameters(family, parameters, (*joints, *others), uncertain)
