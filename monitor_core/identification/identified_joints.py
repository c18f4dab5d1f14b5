"""What an identification answers: the joints, how well each is known, and what the data leave open."""

from collections.abc import Mapping
from dataclasses import dataclass

from monitor_core.arrays import FloatArray, read_only
from monitor_core.fitting.description import AxisDescription
from monitor_core.identification.cases import PredictionError
from monitor_core.identification.directions import Verdict
from monitor_core.identification.sensitivity import Detectability
from monitor_core.preload import Calibration
from monitor_core.uncertainty import Estimate, Interval


@dataclass(frozen=True, slots=True)
class IdentifiedJoint:
    """One joint."""

    estimate: Estimate  # SI
    unit: str
    interval: Interval  # 95 % coverage, SI
    from_profile: bool  # whether the interval is that of the profile of χ² and not linear in the logarithm
    verdict: Verdict
    at_limit: bool
    identifiable: bool  # whether the value may be relied on by itself


@dataclass(frozen=True, slots=True)
class KnownSum:
    """A sum of two stiffnesses, or of two dampings, that is known better than its parts."""

    of: tuple[str, str]  # names in files
    estimate: Estimate  # SI
    unit: str


@dataclass(frozen=True, slots=True)
class FitQuality:
    """How the joints fit the data that they were found from, and how far the search is to be relied on."""

    kind: str  # "whole responses" or "peaks"
    chi_squared: float  # [-]
    degrees_of_freedom: int
    residual_standard_deviation: float  # in units of the stated uncertainties [-]
    lack_of_fit: bool  # the model misses the data by more than their uncertainties
    starts: int
    starts_agreeing: float  # share of the starts that reached the optimum [-]
    evaluations: int
    seed: int
    positions: tuple[float, ...]  # that the fit saw [m]
    paper_objective: float | None  # y of Eq. (26) of Tian et al., of peaks of a receptance model [-]


@dataclass(frozen=True, slots=True)
class HeldOutErrors:
    """How far predictions are off where they were not fitted."""

    errors: tuple[PredictionError, ...]  # at least one
    leave_one_out: bool  # from as many fits as there are positions, each without one
    not_held_out: tuple[float, ...]  # positions that cannot be left out [m]

    @property
    def worst(self) -> PredictionError:
        """The largest of the errors."""
        return max(self.errors, key=lambda error: abs(error.relative_error))


@dataclass(frozen=True, slots=True)
class FurtherPosition:
    """What a further measurement at a position would bring."""

    position: float  # [m]
    relative_uncertainties: Mapping[str, float]  # predicted standard uncertainty of each joint; inf: still unseen [-]


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedJoints:
    """The whole answer."""

    joints: Mapping[str, IdentifiedJoint]  # by their names in files
    correlations: FloatArray  # in the order of the joints, shape (n_joints, n_joints) [-]
    not_identifiable: tuple[str, ...]  # what the data do not determine, in sentences
    sums: tuple[KnownSum, ...]
    quality: FitQuality
    held_out: HeldOutErrors | None  # None where nothing could be held out
    missing_modes: tuple[str, ...]  # modes that a position does not show, in sentences
    next_positions: tuple[FurtherPosition, ...]  # the most helpful first
    modes_to_monitor: tuple[Detectability, ...]  # the best first; empty where the family does not tell
    assumptions: tuple[str, ...]  # what was settled before the fit, in sentences
    calibration: Calibration | None  # predicted from the joints where asked for
    model: AxisDescription  # the description with the joints found

    def __post_init__(self) -> None:
        object.__setattr__(self, "correlations", read_only(self.correlations))
