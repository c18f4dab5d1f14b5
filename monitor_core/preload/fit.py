"""Fit a calibration to readings: weighted least squares of Eq. (8), with payload and temperature where they vary.

How far a calibration carries is told by leaving out a position at a time and predicting its readings from the others.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.modal import PhaseReference
from monitor_core.preload.calibration import (
    COEFFICIENT_NAMES,
    INVERSE_MOVING_MASS,
    TEMPERATURE_COEFFICIENT,
    Calibration,
    ModalReading,
    PositionError,
    ValidRange,
    Weighting,
    declared_influences,
    feature_design,
    known_parameters,
    refuse_blind_mode,
)
from monitor_core.preload.feature import (
    TEMPERATURE_RESOLUTION,
    UNKNOWN_TEMPERATURE_COEFFICIENT,
    USUAL_FRICTION_SHARE,
    InfluenceCoefficients,
    from_reference,
)
from monitor_core.preload.prior import CoefficientPrior, fit_with_prior, refuse_other_conditions
from monitor_core.preload.regression import (
    CoefficientFit,
    ReadingColumns,
    ReadingRows,
    excess_variance,
    position_groups,
    reading_columns,
    refuse_too_few_settings,
    weighted_least_squares,
)
from monitor_core.preload.witnesses import Setting, Witness, WitnessName, fit_witness
from monitor_core.recording import ExcitationQuantity, ExcitationSource, ResponseQuantity
from monitor_core.uncertainty import Estimate, VectorEstimate

#: What another day changes of a frequency unless it is stated, relative: mounting, temperature within the machine,
#: position of the home switch. Some 1.5 % of a preload of which a doubling moves the mode by 1.4 %.
BETWEEN_SESSIONS = 3e-4


def leave_one_position_out(
    columns: ReadingColumns, unloaded: BoolArray, weight: FloatArray, design: FloatArray
) -> tuple[PositionError, ...]:
    """Fit the unloaded readings without one position, and predict that one."""
    position, preload, y = columns.position[unloaded], columns.preload[unloaded], columns.inverse_square[unloaded]
    x, w, slope = design[unloaded], weight[unloaded], columns.slope[unloaded]
    groups = position_groups(position)
    if len(groups) < 4:
        return ()
    errors = []
    for out in groups:
        kept = np.setdiff1d(np.arange(position.size), out)
        if np.unique(preload[kept]).size < 2 or kept.size <= x.shape[1]:
            continue
        try:
            beta = weighted_least_squares(x[kept], y[kept], w[kept]).parameters.values
        except NotIdentifiableError:  # an influence quantity that was varied at that position only
            continue
        miss = y[out] - x[out] @ beta
        theta = np.cbrt(1.0 / preload[out]) + miss / beta[2]
        preload_error = theta**-3.0 - preload[out] if np.all(theta > 0.0) else None
        errors.append(
            PositionError(
                position=float(position[out].mean()),
                frequency_error_rms=float(np.sqrt(np.mean((miss / slope[out]) ** 2))),
                preload_error_rms=None if preload_error is None else float(np.sqrt(np.mean(preload_error**2))),
            )
        )
    return tuple(errors)


def calibrate(
    readings: Sequence[ModalReading],
    *,
    weighting: Weighting | Literal["none", "std"],
    excitation_source: ExcitationSource | None,
    excitation_quantity: ExcitationQuantity | None = None,
    response_quantity: ResponseQuantity | None = None,
    moving_mass: Estimate | None = None,
    temperature_coefficient: Estimate | None = None,
    maximum_modes: int = 2,
    phase_reference: PhaseReference | None = None,
    excitation_level: float | None = None,
    prior: CoefficientPrior | None = None,
    between_sessions: float = 0.0,
    trace_polarity: int | None = None,
) -> Calibration:
    r"""Regress k1…k4 of Eq. (8), with µ and k_T where the readings vary payload and temperature.

    .. math::

        \frac{1}{f^2} = \Bigl(1 + \frac{m - m_0}{M + m_0}\Bigr)
            \Bigl(k_1 x^2 + k_2 x + k_3\,\mathrm{preload}^{-1/3} + k_4 + k_T (T - T_0)\Bigr)

    Eq. (8) of Nguyen et al. (2018); the factor is its Eq. (6). The lowest payload is the reference :math:`m_0`, the
    mean temperature :math:`T_0`.

    The readings are at three or more positions and two or more preloads; with a prior one reading will do. Payload and
    temperature are stated for all of them or for none; no payload stated means an empty table, 0 kg. The weighting
    ``std`` takes the stated standard uncertainties of the frequencies. Where these come from the fit of one record,
    scatter between measurements is usually many times larger and ``none`` uses the readings better. The calibration
    holds for its excitation and response alone, which are ``None`` where a table of frequencies does not tell.

    The moving mass [kg], the effective one without payload, is used where the readings hold one payload only, the
    temperature coefficient [s²/K] where the temperatures span less than ``TEMPERATURE_RESOLUTION``. Number of modes,
    phase reference, excitation level and trace polarity are carried along for what comes before the estimate. A prior
    is what was known of k1…k4 before, from other readings or none: see :func:`fit_with_prior`. Its payload must be the
    lowest of the readings, its excitation theirs.

    The covariance rests on the residuals (n − p degrees of freedom): unweighted on their variance alone, weighted on
    the stated uncertainties plus the scatter between measurements that the residuals show beyond them. The ranges of
    the calibration are those of readings and prior joined.

    ``NotIdentifiableError`` if the readings at the lowest payload cannot determine the coefficients by their positions,
    preloads or number, if they contradict the prior, or if the frequency does not rise measurably with the preload.
    ``OutsideValidityError`` if a preload is missing, an influence quantity is stated for some readings only, a weight
    is missing, or the prior holds under other conditions.

    Readings that bring witnesses (damping ratio, residue, friction torque, excitation level) teach what is usual of
    each. Where friction torque that is above or below the usual goes with 1/f² beyond chance, the readings are
    corrected for it, and so are later measurements: :func:`friction_influence`.

    ``between_sessions`` is declared: what another day changes of a frequency beyond the scatter of the readings,
    relative standard uncertainty (GUM, type B). Readings of one session do not show it, and need it
    (:data:`BETWEEN_SESSIONS`); with 0 the readings are taken to come from as many days as later measurements will.

    k1…k4 and k_T come from the readings at the lowest payload alone, µ from the others against them.

    Errors are taken as independent between readings. An error common to all readings of one level, such as a preload
    that was not quite what it was set to, shows in the residuals but is no smaller for many readings: several levels
    are worth more than many readings of one.

    Examples
    --------
    Table 2 of Nguyen et al. (2018): means at three positions, from 50 to 300 N. The printed Table 3 misses it by
    1.49 Hz rms (``docs/reference/errata.md``).

    >>> import monitor_core as mc
    >>> table = {
    ...     0.25: (189.093, 192.533, 194.210, 195.528, 196.325, 197.021),
    ...     0.50: (172.876, 176.052, 177.377, 178.724, 179.145, 179.830),
    ...     0.75: (175.553, 178.123, 179.690, 180.826, 180.996, 182.379),
    ... }
    >>> mc.calibrate(
    ...     [
    ...         mc.ModalReading(frequency, mc.Conditions(position, preload=preload))
    ...         for position, row in table.items()
    ...         for preload, frequency in zip((50.0, 100.0, 150.0, 200.0, 250.0, 300.0), row)
    ...     ],
    ...     weighting="none",
    ...     excitation_source=None,
    ... )
    Calibration of 18 readings, 0.25 to 0.75 m, 50 to 300 N
      k1 = -4.849e-05 ± 6.8e-07 s²/m², k2 = 5.742e-05 ± 6.9e-07 s²/m
      k3 = 1.915e-05 ± 4.8e-07 s²·N^(1/3), k4 = 1.155e-05 ± 1.8e-07 s²
      residual 0.222 Hz rms, weighting none
    """
    regress = partial(
        _regress,
        weighting=Weighting(weighting),
        excitation_source=excitation_source,
        excitation_quantity=excitation_quantity,
        response_quantity=response_quantity,
        moving_mass=moving_mass,
        temperature_coefficient=temperature_coefficient,
        maximum_modes=maximum_modes,
        phase_reference=phase_reference,
        excitation_level=excitation_level,
        prior=prior,
    )
    carried = partial(replace, between_sessions=between_sessions, trace_polarity=trace_polarity)
    calibration = carried(regress(readings))
    usual = {} if prior is None else {witness.name: witness for witness in prior.witnesses}
    usual |= {witness.name: witness for witness in fit_witnesses(readings, calibration)}
    calibration = replace(calibration, witnesses=tuple(usual.values()))
    friction = friction_influence(readings, calibration)
    if friction is None:
        return replace(calibration, friction=None if prior is None else prior.friction)
    corrected = regress([without_friction(reading, calibration, friction) for reading in readings])
    return carried(_with_one_more_coefficient(corrected), witnesses=calibration.witnesses, friction=friction)


def fit_witnesses(readings: Sequence[ModalReading], calibration: Calibration) -> tuple[Witness, ...]:
    """Learn from the readings of a calibration what is usual of each witness that most of them bring."""
    fitted = []
    for name in WitnessName:
        bring = [reading for reading in readings if name in reading.witnesses]
        if 2 * len(bring) > len(readings):
            settings = [_setting(reading, calibration) for reading in bring]
            fitted.append(fit_witness(name, [reading.witnesses[name] for reading in bring], settings))
    return tuple(witness for witness in fitted if witness is not None)


def _setting(reading: ModalReading, calibration: Calibration) -> Setting:
    preload = reading.conditions.preload
    if preload is None:
        raise OutsideValidityError("a reading of a calibration must state its preload")
    return calibration.setting(reading.conditions, preload)


def friction_influence(readings: Sequence[ModalReading], calibration: Calibration) -> Estimate | None:
    r"""Fit what friction torque beyond the usual adds to 1/f² [s²/(N·m)]; ``None`` where no friction torque is known.

    .. math:: \frac{1}{f^2} = \mathrm{Eq.\,(8)} + k_F\,(T_f - \hat T_f)

    Guides and bearings that are not yet sliding act as springs beside the nut, in proportion to their friction (Dahl
    1968). The friction of a day is known from the same windows; :math:`\hat T_f` is what the calibration lets expect at
    the preload. How large k_F can be is declared (:data:`USUAL_FRICTION_SHARE`); the readings, whose friction differs
    from one to the next, tell it better or leave it at that.
    """
    witness = calibration.witness(WitnessName.FRICTION_TORQUE)
    if witness is None or not any(witness.name in reading.witnesses for reading in readings):
        return None
    columns = reading_columns(readings, calibration.weighting)
    told = np.array([witness.name in reading.witnesses for reading in readings])
    chosen = told & (columns.payload_excess == 0.0)
    excess = np.array([_friction_excess(reading, calibration, witness) for reading in readings])
    design = [feature_design(columns.position, columns.preload)]
    if TEMPERATURE_COEFFICIENT in calibration.parameter_names:
        design.append(columns.temperature_excess[:, np.newaxis])
    matrix = np.column_stack([*design, excess])[chosen]
    usual = [witness.expected(_setting(reading, calibration)) for reading in readings]
    declared = USUAL_FRICTION_SHARE * float(columns.inverse_square.mean()) / float(np.mean(usual))
    try:
        fit = weighted_least_squares(matrix, columns.inverse_square[chosen], np.ones(int(chosen.sum())))
    except NotIdentifiableError:  # the friction never varied, or there are too few readings
        return Estimate(-declared, declared)
    value, uncertainty = fit.parameters.values[-1], fit.parameters.standard_uncertainties[-1]
    precision = uncertainty**-2.0 + declared**-2.0
    mean = (value * uncertainty**-2.0 - declared * declared**-2.0) / precision
    return Estimate(float(mean), float(precision**-0.5))


def _friction_excess(reading: ModalReading, calibration: Calibration, witness: Witness) -> float:
    """Return the friction torque beyond the usual; that of a reading which brings none is taken as usual [N·m]."""
    usual = witness.expected(_setting(reading, calibration))
    return reading.witnesses.get(WitnessName.FRICTION_TORQUE, usual) - usual


def without_friction(reading: ModalReading, calibration: Calibration, friction: Estimate) -> ModalReading:
    """Return a reading with the frequency that it would have at the usual friction."""
    witness = calibration.witness(WitnessName.FRICTION_TORQUE)
    if witness is None:
        return reading
    excess = _friction_excess(reading, calibration, witness)
    return replace(reading, frequency=float((reading.frequency**-2.0 - friction.value * excess) ** -0.5))


def _with_one_more_coefficient(calibration: Calibration) -> Calibration:
    """Count the coefficient of friction among those fitted: one degree of freedom less for the scatter."""
    dof = calibration.parameters.degrees_of_freedom
    wider = dof / (dof - 1.0)
    parameters = replace(
        calibration.parameters, covariance=calibration.parameters.covariance * wider, degrees_of_freedom=dof - 1.0
    )
    return replace(
        calibration,
        parameters=parameters,
        residual_sd=calibration.residual_sd * math.sqrt(wider),
        reproducibility=calibration.reproducibility * math.sqrt(wider),
    )


def _regress(
    readings: Sequence[ModalReading],
    *,
    weighting: Weighting,
    excitation_source: ExcitationSource | None,
    excitation_quantity: ExcitationQuantity | None,
    response_quantity: ResponseQuantity | None,
    moving_mass: Estimate | None,
    temperature_coefficient: Estimate | None,
    maximum_modes: int,
    phase_reference: PhaseReference | None,
    excitation_level: float | None,
    prior: CoefficientPrior | None,
) -> Calibration:
    """Regress k1…k4, µ and k_T as :func:`calibrate` says, the readings as they are."""
    columns = reading_columns(readings, weighting)
    payload_excess, temperature_excess = columns.payload_excess, columns.temperature_excess
    unloaded = payload_excess == 0.0
    if prior is None:
        refuse_too_few_settings(columns.position[unloaded], columns.preload[unloaded])
    else:
        refuse_other_conditions(prior, columns, excitation_source, excitation_quantity, response_quantity)
    weight = np.ones_like(columns.frequency)
    if weighting is Weighting.STD:
        weight = 1.0 / (columns.slope * columns.standard_uncertainty)

    temperature = columns.temperature
    fitted_names = list(COEFFICIENT_NAMES)
    design = feature_design(columns.position, columns.preload)
    if np.ptp(temperature_excess) >= TEMPERATURE_RESOLUTION:
        fitted_names.append(TEMPERATURE_COEFFICIENT)
        design = np.column_stack([design, temperature_excess])
    rows = ReadingRows(
        design[unloaded],
        columns.inverse_square[unloaded],
        weight[unloaded],
        columns.slope[unloaded],
        columns.standard_uncertainty[unloaded],
    )
    fit = _without_prior(rows, weighting) if prior is None else fit_with_prior(prior, rows, weighting)
    fitted = fit.parameters
    refuse_blind_mode(fitted)
    if not unloaded.all():
        single_variance = columns.slope**2 * (columns.standard_uncertainty**2 + fit.reproducibility**2)
        fitted = _with_payload(fitted, design, columns, single_variance)
        fitted_names.insert(len(COEFFICIENT_NAMES), INVERSE_MOVING_MASS)

    if temperature is not None and temperature_coefficient is None:
        typical = float(columns.inverse_square[unloaded].mean())
        temperature_coefficient = Estimate(0.0, UNKNOWN_TEMPERATURE_COEFFICIENT * typical)
    declared = declared_influences(moving_mass, temperature_coefficient, float(columns.payload.min()))
    parameters, names = known_parameters(fitted, fitted_names, declared)
    value_of = {name: float(v) for name, v in zip(fitted_names, fitted.values, strict=True)}
    influence = InfluenceCoefficients(
        value_of.get(INVERSE_MOVING_MASS, 0.0), value_of.get(TEMPERATURE_COEFFICIENT, 0.0)
    )
    predicted = from_reference(
        feature_design(columns.position, columns.preload) @ fitted.values[:4],
        payload_excess,
        temperature_excess,
        influence,
    )
    residual = columns.frequency - predicted**-0.5
    if prior is None:
        residual_variance = np.sum(residual[unloaded] ** 2) / fitted.degrees_of_freedom
    else:  # too few residuals to tell: what prior and readings say together
        residual_variance = fit.reproducibility**2 + np.mean(columns.standard_uncertainty[unloaded] ** 2)
    position, force, payload = _range(columns.position), _range(columns.preload), _range(columns.payload)
    if prior is not None:
        position, force = position.joined(prior.position), force.joined(prior.preload)
        excitation_source = excitation_source or prior.excitation_source
        excitation_quantity = excitation_quantity or prior.excitation_quantity
        response_quantity = response_quantity or prior.response_quantity
    return Calibration(
        parameters=parameters,
        parameter_names=names,
        declared=tuple(name for name in names if name not in fitted_names),
        reproducibility=fit.reproducibility,
        residual_sd=float(np.sqrt(residual_variance)),
        residual_rms=float(np.sqrt(np.mean(residual**2))),
        residual_max=float(np.max(np.abs(residual))),
        condition_number=fit.condition_number,
        leave_one_position_out=() if prior is not None else leave_one_position_out(columns, unloaded, weight, design),
        weighting=weighting,
        n_readings=len(readings),
        position=position,
        preload=force,
        payload=payload,
        temperature=None if temperature is None else _range(temperature),
        reference_payload=float(columns.payload.min()),
        reference_temperature=None if temperature is None else float(temperature.mean()),
        excitation_source=excitation_source,
        excitation_quantity=excitation_quantity,
        response_quantity=response_quantity,
        maximum_modes=maximum_modes,
        phase_reference=phase_reference,
        moving_mass_dof=math.inf if unloaded.all() else max(np.count_nonzero(~unloaded) - 1.0, 1.0),
        uncertainty_stated=bool(np.all(columns.standard_uncertainty > 0.0)),
        excitation_level=excitation_level,
        prior=None if prior is None else prior.source,
        payload_stated=readings[0].conditions.payload_mass is not None,
    )


def _without_prior(rows: ReadingRows, weighting: Weighting) -> CoefficientFit:
    fit = weighted_least_squares(rows.design, rows.inverse_square, rows.weight)
    reproducibility = float(np.sqrt(max(0.0, excess_variance(rows, fit.residual, fit.leverage))))
    parameters = fit.parameters
    if weighting is Weighting.STD:
        # scatter between measurements is common to all readings, so the weights are not their inverse variances
        covariance = fit.covariance_under(rows.slope**2 * (rows.stated**2 + reproducibility**2))
        parameters = VectorEstimate(parameters.values, covariance, parameters.degrees_of_freedom)
    return CoefficientFit(parameters, reproducibility, fit.condition_number)


def _range(values: FloatArray) -> ValidRange:
    return ValidRange(float(values.min()), float(values.max()))


def _with_payload(
    unloaded: VectorEstimate, design: FloatArray, columns: ReadingColumns, single_variance: FloatArray
) -> VectorEstimate:
    r"""Append µ, from how far each loaded reading lies from what the unloaded ones predict for it.

    :math:`\mu_i = (y_i / \hat y_i - 1)/m_i`, averaged with weights :math:`m_i^2`. A real axis follows
    :math:`f \propto 1/\sqrt{M + m}` only roughly (the screw turns and stretches along), so the µ of different payloads
    and positions scatter more than their own uncertainties. The next payload will scatter alike: that goes into the
    uncertainty of µ, which has as many degrees of freedom less one, and not into the scatter of unloaded readings.
    """
    loaded = columns.payload_excess > 0.0
    y, m, x = columns.inverse_square[loaded], columns.payload_excess[loaded], design[loaded]
    predicted = x @ unloaded.values
    mu = (y / predicted - 1.0) / m
    share = m**2 / np.sum(m**2)
    mean = float(share @ mu)
    if mean <= 0.0:
        raise NotIdentifiableError(f"payload must lower the frequency; the readings give 1/M = {mean:.3g} 1/kg")
    variance = float(np.sum(share**2 * single_variance[loaded] / (predicted * m) ** 2))
    n = mu.size
    if n > 1:
        scatter = float(share @ (mu - mean) ** 2) * n / (n - 1)
        variance = max(variance, scatter * (1.0 + 1.0 / n))
    gradient = -((share * y / (predicted**2 * m)) @ x)  # of µ, with respect to the unloaded parameters
    across = unloaded.covariance @ gradient
    k = len(COEFFICIENT_NAMES)
    covariance = np.insert(np.insert(unloaded.covariance, k, across, axis=0), k, np.insert(across, k, 0.0), axis=1)
    covariance[k, k] = variance + gradient @ across
    return VectorEstimate(np.insert(unloaded.values, k, mean), covariance, unloaded.degrees_of_freedom)
