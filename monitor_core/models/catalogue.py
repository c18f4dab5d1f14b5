r"""A drive model from what a catalogue states: screw, nut, bearings, moved mass; and where its first axial mode can be.

What no catalogue states is filled in by rules of size, and says so by its tolerance. The band that follows is wide, and
narrow enough to look for the mode in: it is replaced by the calibration.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Final

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import ExtendedModel, elastic_frequencies
from monitor_core.models.parameters import name_in_file
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance import ReceptanceParameters

#: Steel of screws.
_YOUNG, _SHEAR, _DENSITY = 206e9, 79.23e9, 7850.0  # [Pa], [Pa], [kg/m³]; shear: Poisson's ratio 0.3
#: Axial rigidity of the fixed bearing in its housing over the screw's diameter; Table 1 of Nguyen et al. (2018):
#: 100 N/µm at 20 mm.
_BEARING_PER_DIAMETER: Final = 5.0e9  # [N/m²]
#: Rigidity of the bracket between nut and table, of the nut's at 10 % of its load rating: what is left of Table 1 once
#: its print is corrected (``docs/reference/errata.md``) lies between a tenth and a half.
_BRACKET_TO_NUT: Final = 0.25
#: Torsional rigidity of a coupling over the cube of the screw's diameter; Table 1 of Nguyen et al. (2018): 849 N·m/rad
#: at 20 mm.
_COUPLING_PER_CUBE: Final = 1.0e8  # [N·m/rad/m³]
#: Inertia of a servo motor of the screw's size, of that of the screw: makers match them.
_MOTOR_TO_SCREW: Final = 1.0
#: Relative standard deviations of what is filled in, and of what catalogues state.
_GUESSED, _STATED, _WEIGHED = 0.4, 0.2, 0.03
_LOSS_FACTOR: Final = 0.03
#: The band reaches from a nut that has lost nearly all of its preload to one a bit above it.
NEARLY_LOST, OVERLOADED = 0.1, 1.5
#: Half width of the band in standard deviations of what the tolerances do to the frequency.
_REACH: Final = 2.0
_STEP: Final = 0.05  # of ln(parameter), for the derivatives
#: Longest screw in diameters: catalogues end at 80.
_MOST_SLENDER: Final = 200.0


class NutKind(StrEnum):
    """How a nut is preloaded."""

    DOUBLE = "double"  #: two nuts against each other
    OVERSIZE_BALLS = "oversize-balls"  #: one nut, four points of contact

    @property
    def usual_share(self) -> float:
        """The preload that makers set, of the dynamic load rating [-]."""
        return 0.07 if self is NutKind.DOUBLE else 0.05


class BearingArrangement(StrEnum):
    """How a screw is held at its ends."""

    FIXED_FREE = "fixed-free"
    FIXED_SUPPORTED = "fixed-supported"  #: the far bearing carries no axial load
    FIXED_FIXED = "fixed-fixed"


@dataclass(frozen=True, slots=True, kw_only=True)
class CatalogueData:
    """What a catalogue and a scale say of an axis; the defaults are an axis of the size of Nguyen et al. (2018)."""

    screw_diameter: float = 0.020  # [m]
    screw_lead: float = 0.006  # [m]
    screw_length: float = 0.971  # between the bearings [m]
    moved_mass: float = 22.0  # table, nut and what is fixed to them [kg]
    nut_stiffness: float = 470e6  # K at 10 % of the dynamic load rating [N/m]
    dynamic_load_rating: float = 4000.0  # C_d [N]
    nut_kind: NutKind = NutKind.DOUBLE
    bearings: BearingArrangement = BearingArrangement.FIXED_SUPPORTED
    preload: float | None = None  # as it was set; None: what makers set [N]

    def __post_init__(self) -> None:
        longest = _MOST_SLENDER * self.screw_diameter
        if 0.0 < longest < self.screw_length:
            raise OutsideValidityError(
                f"a screw of {self.screw_diameter:g} m diameter is expected to be at most {longest:g} m long, or it "
                f"would not stay straight; got {self.screw_length:g} m"
            )
        highest = 0.1 * self.dynamic_load_rating
        if self.preload is not None and not 0.0 < self.preload <= highest:
            raise OutsideValidityError(
                f"preload must be above 0 and at most 10 % of the dynamic load rating, {highest:g} N; got "
                f"{self.preload:g} N"
            )

    @property
    def set_preload(self) -> float:
        """The preload as it was set, or what makers set [N]."""
        return self.nut_kind.usual_share * self.dynamic_load_rating if self.preload is None else self.preload


@dataclass(frozen=True, slots=True)
class CatalogueDrive:
    """A drive of the family ``receptance``, and how well each of its parameters is known."""

    parameters: ReceptanceParameters
    uncertain: Mapping[str, float]  # relative standard deviation, by the names of the model file [-]
    preload: float  # [N]
    family: str = field(default="receptance", init=False)


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedMode:
    """The first axial natural frequency over the positions of the table."""

    position: FloatArray  # shape (n_positions,) [m]
    frequency: FloatArray  # with the preload as set [Hz]
    lower: FloatArray  # preload nearly lost, less the tolerance [Hz]
    upper: FloatArray  # preload a bit above what was set, with the tolerance [Hz]

    def __post_init__(self) -> None:
        for name in ("position", "frequency", "lower", "upper"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def band(self) -> tuple[float, float]:
        """Where to look for the mode, at whatever position [Hz]."""
        return float(self.lower.min()), float(self.upper.max())


def drive_from_catalogue(data: CatalogueData) -> CatalogueDrive:
    """Return the drive of catalogue data, with what these leave out filled in.

    The nut follows the preload by Eq. (1) of Nguyen et al. (2018). ``OutsideValidityError`` if a value is not positive
    or no length of a machine.
    """
    diameter = data.screw_diameter
    screw_inertia = _DENSITY * math.pi * diameter**4 / 32.0 * data.screw_length
    bearing = _BEARING_PER_DIAMETER * diameter
    parameters = ReceptanceParameters(
        table_mass=data.moved_mass,
        screw_length=data.screw_length,
        screw_diameter=diameter,
        screw_lead=data.screw_lead,
        youngs_modulus=_YOUNG,
        shear_modulus=_SHEAR,
        density=_DENSITY,
        motor_inertia=_MOTOR_TO_SCREW * screw_inertia,
        bearing_stiffness=bearing,
        far_bearing_stiffness=bearing if data.bearings is BearingArrangement.FIXED_FIXED else 0.0,
        bracket_stiffness=_BRACKET_TO_NUT * data.nut_stiffness,
        nut_stiffness=data.nut_stiffness,
        dynamic_load_rating=data.dynamic_load_rating,
        coupling_stiffness=_COUPLING_PER_CUBE * diameter**3,
        loss_factor=_LOSS_FACTOR,
    )
    shares = {
        "table_mass": _WEIGHED,
        "nut_stiffness": _STATED,
        "bearing_stiffness": _GUESSED,
        "bracket_stiffness": _GUESSED,
        "coupling_stiffness": _GUESSED,
        "motor_inertia": _GUESSED,
        **({"far_bearing_stiffness": _GUESSED} if parameters.far_bearing_stiffness else {}),
    }
    return CatalogueDrive(parameters, {name_in_file(name): share for name, share in shares.items()}, data.set_preload)


def expected_mode(drive: CatalogueDrive, motor_end: MotorEnd) -> ExpectedMode:
    r"""Predict the first axial natural frequency of a drive over its screw, and the band that it can be in.

    The band reaches from the nut nearly without preload to one half as much again (at most 10 % of its load rating),
    widened by two standard deviations of what the tolerances do to the frequency,

    .. math:: s_{\ln f}^2 = \sum_i \left( \frac{\partial \ln f}{\partial \ln p_i} s_i \right)^2

    by differences at the middle of the screw. The motor end is that of the torque that is measured: *prescribed* by a
    sensor at the screw, *free* for the torque of the motor.
    """
    p, places = drive.parameters, np.linspace(0.1, 0.9, 5) * drive.parameters.screw_length
    rating = p.dynamic_load_rating or math.inf
    forces = (drive.preload, NEARLY_LOST * drive.preload, min(OVERLOADED * drive.preload, 0.1 * rating))
    under = [DriveConditions(float(place), force) for force in forces for place in places]
    set_to, lost, raised = _first_frequencies(p, under, motor_end).reshape(len(forces), places.size)
    middle = DriveConditions(float(np.median(places)), drive.preload)
    (at_middle,) = np.log(_first_frequencies(p, [middle], motor_end))
    variance = 0.0
    for name, share in _by_field(drive).items():
        moved = replace(p, **{name: getattr(p, name) * math.exp(_STEP)})
        slope = float(np.log(_first_frequencies(moved, [middle], motor_end))[0] - at_middle) / _STEP
        variance += (slope * share) ** 2
    factor = math.exp(_REACH * math.sqrt(variance))
    return ExpectedMode(places, set_to, lost / factor, raised * factor)


def _by_field(drive: CatalogueDrive) -> dict[str, float]:
    """Return the tolerances by the fields of the record."""
    fields = {name_in_file(name): name for name in type(drive.parameters).__dataclass_fields__}
    return {fields[name]: share for name, share in drive.uncertain.items()}


def _first_frequencies(
    parameters: ReceptanceParameters, conditions: Sequence[DriveConditions], motor_end: MotorEnd
) -> FloatArray:
    """Return the first natural frequency under each condition [Hz]; OutsideValidityError where there is none."""
    model = ExtendedModel.of(parameters)
    elastic = elastic_frequencies(model, conditions, motor_end)
    if not all(frequencies.size for frequencies in elastic):
        raise OutsideValidityError(
            f"expected an axis with a natural frequency below {model.highest_frequency:g} Hz; got one without: its "
            "screw is too short, or its mass too small"
        )
    return np.array([frequencies[0] for frequencies in elastic])
