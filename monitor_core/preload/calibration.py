"""Define a calibration, k1…k4 of Eq. (8) with covariance and influences, and predict frequencies from it alone.

A calibration is a frozen record of all that later estimates rest on: the joint covariance of what was fitted, the
scatter between measurements, the ranges it holds in, and the excitation source it is valid for.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, Shown
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.modal import PhaseReference
from monitor_core.preload.feature import (
    InfluenceCoefficients,
    PreloadFeatureCoefficients,
    axial_frequency,
    from_reference,
    payload_factor,
    preload_from_feature,
)
from monitor_core.preload.witnesses import Setting, Witness, WitnessName, WitnessValues
from monitor_core.recording import Conditions, ExcitationQuantity, ExcitationSource, ResponseQuantity
from monitor_core.uncertainty import Estimate, VectorEstimate, plus_minus

if TYPE_CHECKING:
    from monitor_core.shown import Panel

#: Order of the parameter vector; the last two only where they are known.
COEFFICIENT_NAMES = ("k1", "k2", "k3", "k4")
INVERSE_MOVING_MASS = "inverse_moving_mass"
TEMPERATURE_COEFFICIENT = "temperature_coefficient"


class Weighting(StrEnum):
    """How the readings of a calibration are weighted."""

    NONE = "none"  #: every 1/f² alike
    STD = "std"  #: by the inverse standard uncertainty of 1/f², 2σ_f/f³


@dataclass(frozen=True, slots=True)
class ModalReading:
    """One measured natural frequency, or the mean of several, and the conditions it was taken under."""

    frequency: float  # axial natural frequency [Hz]
    conditions: Conditions
    frequency_std: float | None = None  # scatter of a single reading, or the σ of its fit [Hz]
    n_readings: int = 1  # how many readings the frequency is the mean of
    witnesses: WitnessValues = field(default_factory=dict)  # what else the windows hold; empty: not known

    def __post_init__(self) -> None:
        if not (np.isfinite(self.frequency) and self.frequency > 0.0):
            raise OutsideValidityError(f"frequency must be positive; got {self.frequency} Hz")
        if self.frequency_std is not None and not (np.isfinite(self.frequency_std) and self.frequency_std >= 0.0):
            raise OutsideValidityError(f"frequency_std must not be negative; got {self.frequency_std} Hz")
        if self.n_readings < 1:
            raise OutsideValidityError(f"n_readings must be at least 1; got {self.n_readings}")

    @property
    def standard_uncertainty(self) -> float | None:
        """Of the mean, std/√n [Hz]; ``None`` where the scatter is not stated."""
        return None if self.frequency_std is None else self.frequency_std / float(np.sqrt(self.n_readings))

    @property
    def estimate(self) -> Estimate:
        """The frequency with its uncertainty; without a stated scatter only the calibration's own scatter counts."""
        return Estimate(
            value=self.frequency,
            standard_uncertainty=self.standard_uncertainty or 0.0,
            degrees_of_freedom=self.n_readings - 1 if self.n_readings > 1 else np.inf,
        )


@dataclass(frozen=True, slots=True)
class PositionError:
    """Prediction errors at a position that was left out of the fit."""

    position: float  # [m]
    frequency_error_rms: float  # [Hz]
    preload_error_rms: float | None  # [N]; None where a reading lies above what any preload gives


@dataclass(frozen=True, slots=True)
class ValidRange:
    """The values of a quantity that a calibration has seen, from the smallest to the largest."""

    lower: float
    upper: float

    def covers(self, value: float, *, margin: float = 0.0) -> bool:
        """Tell whether a value lies inside, or at most a margin (in the same unit) outside."""
        return self.lower - margin <= value <= self.upper + margin

    def joined(self, other: "ValidRange") -> "ValidRange":
        """Return the range from the smallest to the largest value of both."""
        return ValidRange(min(self.lower, other.lower), max(self.upper, other.upper))


@dataclass(frozen=True, slots=True, eq=False)
class Calibration(Shown):
    """Eq. (8) of Nguyen et al. (2018) as regressed for one axis, one excitation and one response."""

    parameters: VectorEstimate  # k1…k4 and, where known, µ and k_T: SI units, joint covariance, degrees of freedom
    parameter_names: tuple[str, ...]  # in the order of ``parameters``
    declared: tuple[str, ...]  # those of them that were declared, not fitted: independent of the residuals
    reproducibility: float  # scatter between measurements beyond their own stated uncertainty [Hz]
    residual_sd: float  # of one reading about the fit, with n − p degrees of freedom [Hz]
    residual_rms: float | None  # [Hz]; None where there are no readings, as below
    residual_max: float | None  # [Hz]
    condition_number: float
    leave_one_position_out: tuple[PositionError, ...]  # empty with three positions, none can be spared, and on a prior
    weighting: Weighting
    n_readings: int  # 0: on a prior alone
    position: ValidRange  # [m]
    preload: ValidRange  # [N]
    payload: ValidRange  # [kg]
    temperature: ValidRange | None  # [°C]; None: not stated
    reference_payload: float  # to which µ belongs and readings are corrected [kg]
    reference_temperature: float | None  # [°C]
    excitation_source: ExcitationSource | None  # None: not stated (a table of frequencies)
    excitation_quantity: ExcitationQuantity | None
    response_quantity: ResponseQuantity | None = None  # None: not stated; with an excitation stated, acceleration
    maximum_modes: int = 2  # what the frequencies were fitted with; later ones are fitted alike
    phase_reference: PhaseReference | None = None  # None: the table of frequencies does not tell
    moving_mass_dof: float = math.inf  # degrees of freedom of a fitted µ: it rests on the loaded readings alone
    uncertainty_stated: bool = True  # whether the readings stated theirs; if not, it is part of ``reproducibility``
    excitation_level: float | None = None  # rms per root hertz around the mode, as calibrated [unit of it/√Hz]
    prior: str | None = None  # source of what was known of k1…k4 before the readings; None: they rest on these alone
    witnesses: tuple[Witness, ...] = ()  # what else the windows held at the calibration; empty: nothing is compared
    friction: Estimate | None = None  # k_F, what friction torque adds to 1/f²; None: it is not seen to [s²/(N·m)]
    between_sessions: float = 0.0  # what another day changes of a frequency, relative standard uncertainty (type B) [-]
    payload_stated: bool = False  # whether the readings stated one; if not, what it does is part of their scatter
    trace_polarity: int | None = None  # 1: a positive torque drove along the trace, -1: against; None: not seen

    def __post_init__(self) -> None:
        if self.parameter_names[:4] != COEFFICIENT_NAMES or len(self.parameter_names) != self.parameters.values.size:
            raise OutsideValidityError(
                f"parameters must be {', '.join(COEFFICIENT_NAMES)} and at most {INVERSE_MOVING_MASS} and "
                f"{TEMPERATURE_COEFFICIENT}; got {self.parameter_names} for {self.parameters.values.size} values"
            )
        if self.response_quantity is None and self.excitation_quantity is not None:  # as all records once were
            object.__setattr__(self, "response_quantity", ResponseQuantity.ACCELERATION)
        _ = self.coefficients  # a calibration whose k3 is not positive cannot exist

    def __repr__(self) -> str:
        """Return it in four lines: what it rests on, where it holds, k1…k4 with standard uncertainties, residuals."""
        ks = (self.parameter(name) for name in COEFFICIENT_NAMES)
        k = [plus_minus(each.value, each.standard_uncertainty) for each in ks if each is not None]
        rms = "no residual" if self.residual_rms is None else f"residual {self.residual_rms:.3g} Hz rms"
        return (
            f"Calibration of {self.n_readings} readings, {self.position.lower:g} to {self.position.upper:g} m, "
            f"{self.preload.lower:g} to {self.preload.upper:g} N\n"
            f"  k1 = {k[0]} s²/m², k2 = {k[1]} s²/m\n"
            f"  k3 = {k[2]} s²·N^(1/3), k4 = {k[3]} s²\n"
            f"  {rms}, weighting {self.weighting}"
        )

    def _panels(self) -> "Sequence[Panel]":
        from monitor_core.shown import Panel  # noqa: PLC0415  # few ask

        x = np.linspace(self.position.lower, self.position.upper, 101)
        preloads = np.linspace(self.preload.lower, self.preload.upper, 4)
        lines = {f"{preload:.4g} N": axial_frequency(x, preload, self.coefficients) for preload in preloads}
        return [Panel("Eq. (8)", "position [m]", "axial frequency [Hz]", x, np.full(x.size, np.nan), lines)]

    def _columns(self) -> Mapping[str, Sequence[object] | FloatArray]:
        estimates = [self.parameter(name) for name in self.parameter_names]
        return {
            "parameter": self.parameter_names,
            "value": [None if each is None else each.value for each in estimates],
            "standard_uncertainty": [None if each is None else each.standard_uncertainty for each in estimates],
            "declared": [name in self.declared for name in self.parameter_names],
        }

    @property
    def coefficients(self) -> PreloadFeatureCoefficients:
        """k1…k4 at the reference payload and temperature."""
        return PreloadFeatureCoefficients(*(float(k) for k in self.parameters.values[:4]))

    def parameter(self, name: str) -> Estimate | None:
        """Return one parameter in SI units, or ``None`` if it is neither fitted nor declared."""
        if name not in self.parameter_names:
            return None
        i = self.parameter_names.index(name)
        dof = self.parameters.degrees_of_freedom
        if name in self.declared:
            dof = math.inf
        elif name == INVERSE_MOVING_MASS:
            dof = self.moving_mass_dof
        return Estimate(float(self.parameters.values[i]), float(self.parameters.standard_uncertainties[i]), dof)

    @property
    def influence(self) -> InfluenceCoefficients:
        """µ and k_T; zero where not known."""
        of = dict(zip(self.parameter_names, self.parameters.values.tolist(), strict=True))
        return InfluenceCoefficients(of.get(INVERSE_MOVING_MASS, 0.0), of.get(TEMPERATURE_COEFFICIENT, 0.0))

    @property
    def moving_mass(self) -> Estimate | None:
        """Effective mass M that moves in the axial mode, without payload [kg]; ``None`` if not known."""
        mu = self.parameter(INVERSE_MOVING_MASS)
        if mu is None:
            return None
        return Estimate(
            1.0 / mu.value - self.reference_payload, mu.standard_uncertainty / mu.value**2, mu.degrees_of_freedom
        )

    def witness(self, name: WitnessName) -> Witness | None:
        """Return what the calibration lets expect of a quantity, or ``None`` if it has not seen it."""
        return next((witness for witness in self.witnesses if witness.name is name), None)

    def setting(self, conditions: Conditions, preload: float) -> Setting:
        """Return the conditions as witnesses follow them, at a preload [N]."""
        payload, temperature = self.excess(conditions)
        factor = float(payload_factor(payload, self.influence.inverse_moving_mass))
        return Setting(conditions.position, preload, factor, temperature)

    def excess(self, conditions: Conditions) -> tuple[float, float]:
        """Return payload [kg] and temperature [K] above the reference; what is not stated is taken as the reference."""
        payload, temperature = conditions.payload_mass, conditions.temperature
        return (
            0.0 if payload is None else payload - self.reference_payload,
            0.0
            if temperature is None or self.reference_temperature is None
            else temperature - self.reference_temperature,
        )


def feature_design(position: FloatArray, preload: FloatArray) -> FloatArray:
    """Lay out Eq. (8) for k1…k4: columns x² [m²], x [m], preload^(−1/3) [N^(−1/3)], 1; shape (n_windows, 4)."""
    return np.column_stack([position**2, position, np.cbrt(1.0 / preload), np.ones_like(position)])


def known_parameters(
    fitted: VectorEstimate, names: Sequence[str], declared: dict[str, Estimate]
) -> tuple[VectorEstimate, tuple[str, ...]]:
    """Append declared parameters to fitted ones; the two are independent of each other."""
    extra = [(name, estimate) for name, estimate in declared.items() if name not in names]
    n, p = fitted.values.size + len(extra), fitted.values.size
    covariance = np.zeros((n, n))
    covariance[:p, :p] = fitted.covariance
    covariance[range(p, n), range(p, n)] = [e.standard_uncertainty**2 for _, e in extra]
    values = np.concatenate([fitted.values, [e.value for _, e in extra]])
    return (
        VectorEstimate(values, covariance, fitted.degrees_of_freedom),
        (*names, *(name for name, _ in extra)),
    )


def declared_influences(
    moving_mass: Estimate | None, temperature_coefficient: Estimate | None, reference_payload: float
) -> dict[str, Estimate]:
    """Return µ and k_T by name where the mass that moves without payload [kg] or k_T [s²/K] are declared."""
    declared = {}
    if moving_mass is not None:
        total = moving_mass.value + reference_payload
        if not moving_mass.value > 0.0:
            raise OutsideValidityError(f"moving_mass must be positive; got {moving_mass.value} kg")
        declared[INVERSE_MOVING_MASS] = Estimate(1.0 / total, moving_mass.standard_uncertainty / total**2)
    if temperature_coefficient is not None:
        declared[TEMPERATURE_COEFFICIENT] = temperature_coefficient
    return declared


def refuse_blind_mode(fitted: VectorEstimate) -> None:
    """Refuse a k3 that is not significantly positive: no interval of the preload would have an upper end."""
    k3, uncertainty = fitted.values[2], fitted.standard_uncertainties[2]
    if k3 <= scipy.special.stdtrit(fitted.degrees_of_freedom, 0.975) * uncertainty:
        raise NotIdentifiableError(
            "the frequency does not rise measurably with the preload: k3 must be positive beyond its 95 % uncertainty; "
            f"got ({plus_minus(float(k3), float(uncertainty))}) s²·N^(1/3). Spread the preloads further, or choose "
            "another mode"
        )


#: The band reaches from a preload nearly lost to one a bit over the highest calibrated, by these factors.
NEARLY_LOST, OVERLOADED = 0.1, 1.5
#: What an untagged payload or temperature may shift the frequency by, relative.
BAND_MARGIN = 0.01


@lru_cache(maxsize=64)  # the windows of a measurement are asked for one by one, and have the same conditions
def expected_band(calibration: Calibration, conditions: Conditions) -> tuple[float, float]:
    """Tell between which frequencies the axial mode can be, in hertz.

    Eq. (8) of Nguyen et al. (2018) from 10 % of the lowest to 150 % of the highest calibrated preload, under the stated
    payload and temperature, widened by 1 % and four standard deviations of a reading. ``OutsideValidityError`` if it
    gives no frequency at that position (far outside the calibrated ones).

    With Table 2 of the paper (measured there from 50 to 300 N: 172.9 to 179.8 Hz), the band at 500 mm is about 157 to
    183 Hz.
    """
    payload, temperature = calibration.excess(conditions)
    preload = np.array([NEARLY_LOST * calibration.preload.lower, OVERLOADED * calibration.preload.upper])
    at_reference = axial_frequency(conditions.position, preload, calibration.coefficients) ** -2.0
    low, high = from_reference(at_reference, payload, temperature, calibration.influence) ** -0.5
    scatter = 4.0 * calibration.residual_sd
    return float(low * (1.0 - BAND_MARGIN) - scatter), float(high * (1.0 + BAND_MARGIN) + scatter)


def expected_frequency(calibration: Calibration, conditions: Conditions) -> float:
    """Return the frequency that a calibration expects at a stated preload, by Eq. (8) of Nguyen et al. (2018) [Hz].

    ``OutsideValidityError`` if no preload is stated, or it gives no frequency at that position.
    """
    if conditions.preload is None:
        raise OutsideValidityError(
            "the frequency that is expected follows from the preload; got conditions without one"
        )
    payload, temperature = calibration.excess(conditions)
    at_reference = axial_frequency(conditions.position, conditions.preload, calibration.coefficients) ** -2.0
    return float(from_reference(at_reference, payload, temperature, calibration.influence) ** -0.5)


def minimum_detectable_loss(
    calibration: Calibration,
    preload: float | None = None,  # healthy; the highest calibrated one if not given [N]
    position: float | None = None,  # if not given, the calibrated one where the loss is hardest to see [m]
    n_measurements: int = 1,  # that are averaged
) -> float:
    r"""Tell the smallest loss of preload that will be seen, in newtons.

    Seen means: starting from a healthy preload that is known from many measurements, the mean of ``n_measurements``
    lies below the one-sided 95 % prediction bound with a probability of 90 %. With s the standard deviation of a
    reading in the calibration (n − p degrees of freedom) the frequency must fall by
    :math:`(t_{.95} + t_{.90})\,s/\sqrt{n}`; Eq. (8) of Nguyen et al. (2018) turns the fall into newtons. A preload that
    is not positive raises ``OutsideValidityError``.

    With Table 2 of the paper (means of 20 readings, 0.25 Hz) at 300 N and 500 mm, 0.78 Hz at about 100 N/Hz: some 70 N.
    """
    k, dof = calibration.coefficients, calibration.parameters.degrees_of_freedom
    healthy = calibration.preload.upper if preload is None else preload
    positions = np.linspace(calibration.position.lower, calibration.position.upper, 101)
    f = axial_frequency(positions if position is None else np.array([position]), healthy, k)
    quantiles = scipy.special.stdtrit(dof, 0.95) + scipy.special.stdtrit(dof, 0.90)
    fall = quantiles * calibration.residual_sd / np.sqrt(n_measurements)
    feature = k.k3 * np.cbrt(1.0 / healthy) + 2.0 * fall / f**3
    return float(np.max(healthy - preload_from_feature(feature, k)))
