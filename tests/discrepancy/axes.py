"""Small data for the tests of the discrepancy engine: a linear misfit with its algebra, and an axis with few settings.

Of the linear misfit every answer is known in closed form. The axis is measured by the model's own family, so that what
is hidden in it is what the model lacks and nothing else.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from monitor_core.effects import DRIVE_EFFECTS, PREFIX, sized_for
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.comparison import Layout, Setting
from monitor_core.fitting.conditions.settings import SettingTolerances, default_folds
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.residuals.model_form import DEFAULT_SPECTRUM, ModelFormError
from monitor_core.fitting.residuals.responses import compare_responses
from monitor_core.models.extended import ResponseCase, physics_of, prepare_lines, responses
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint, motor_end_of
from monitor_core.models.published.lumped import LumpedParameters

# --- a linear misfit -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LinearAxis:
    """An axis that is a vector of quantities, of which the first ones are uncertain."""

    uncertain: dict[str, float]
    size: int

    def physics(self, ln_ratios):
        theta = np.zeros(self.size)
        for index, name in enumerate(self.uncertain):
            theta[index] = ln_ratios.get(name, 0.0)
        return theta


@dataclass(frozen=True, eq=False)
class LinearComparison:
    """Misfit A θ − y + Sᵀ e of a vector θ, with errors e of the settings that change it by S."""

    layout: Layout
    design: np.ndarray  # A, shape (n_values, size)
    data: np.ndarray  # y
    directions: np.ndarray  # S, shape (n_errors, n_values)
    errors: np.ndarray | float = 0.0  # that the settings are taken to have
    unit: str = "sigma"
    noise_floor: float = 1.0
    least_delta_bic: float = 10.0

    @property
    def condition_error_names(self):
        return tuple(f"error {index + 1}" for index in range(len(self.directions)))

    def misfit(self, physics):
        errors = np.broadcast_to(self.errors, (len(self.layout.settings), len(self.directions)))
        return self.design @ physics - self.data + np.sum(self.directions * errors[self.layout.setting].T, axis=0)

    def condition_errors(self, physics, misfit):
        return self.directions

    def imagined(self, physics):
        return {}

    def shifted(self, errors):
        return replace(self, errors=self.errors + errors)

    def resolved(self, physics, errors):
        return self

    def gap(self, misfit, standardised, chosen):
        return float(np.sqrt(np.mean(standardised[chosen] ** 2)))

    def panels(self, models):
        return ()


def layout_of(sizes, deviation, *, held_out=(), frequency=np.nan, period=np.inf):
    """Return the layout of one channel in settings of these sizes."""
    n = sum(sizes)
    return Layout(
        settings=tuple(Setting(f"{index}", {ConditionAxis.POSITION: 0.1 * index}) for index in range(len(sizes))),
        setting=np.repeat(np.arange(len(sizes)), sizes),
        channel=np.zeros(n, dtype=np.intp),
        channels=("misfit",),
        frequency=np.broadcast_to(frequency, (n,)),
        standard_deviation=np.broadcast_to(deviation, (n,)),
        period=np.broadcast_to(period, (n,)),
        held_out=held_out,
    )


def quantity(index, key=None, *, lower=-50.0, upper=50.0, scale=1.0):
    """Return the effect that adds to one quantity."""

    def add(theta, values):
        changed = theta.copy()
        changed[index] += values["size"]
        return changed

    parameter = EffectParameter("size", "-", lower=lower, upper=upper, scale=scale)
    return Effect(key or f"quantity-{index}", f"Quantity {index}", "It adds.", "this test", (parameter,), add)


def wrong_quantity(index, name):
    """Return the effect that an uncertain quantity is not held by its tolerance."""

    def add(theta, values):
        changed = theta.copy()
        changed[index] += values["ln_ratio"]
        return changed

    parameter = EffectParameter("ln_ratio", "-", lower=-3.0, upper=3.0, scale=0.1)
    return Effect(f"{PREFIX}{name}", f"Wrong {name}", "It adds.", "this test", (parameter,), add)


def covariance_of(comparison):
    """Return the covariance of the misfit, noise and errors of settings, shape (n_values, n_values)."""
    same = comparison.layout.setting[:, None] == comparison.layout.setting
    return np.diag(comparison.layout.standard_deviation**2) + same * (comparison.directions.T @ comparison.directions)


# --- an axis with few settings ---------------------------------------------------------------------------------------

#: A drive of ordinary size; its far end is free in the axial direction.
AXIS = LumpedParameters(
    table_mass=20.0,
    screw_mass=2.0,
    nut_mass=1.3,
    screw_inertia=1.2e-4,
    screw_length=0.97,
    screw_minor_diameter=0.0172,
    screw_lead=0.006,
    youngs_modulus=2.06e11,
    shear_modulus=7.9e10,
    bearing_stiffness=1.0e8,
    bracket_stiffness=2.1e8,
    nut_stiffness=4.7e8,
    dynamic_load_rating=4000.0,
    coupling_stiffness=850.0,
    motor_inertia=1.0e-4,
    loss_factor=0.03,
)
#: Relative standard deviations of what was not measured.
TOLERANCES = {"bearing_stiffness_n_per_m": 0.2, "bracket_stiffness_n_per_m": 0.2, "loss_factor": 0.3}
POSITIONS = (0.0831, 0.2113, 0.3455, 0.4762, 0.6047, 0.7394, 0.8683)
LINES = np.geomspace(40.0, 900.0, 40)
NOISE = 0.003  # of every line
#: The axis is measured by its own family.
FORM = ModelFormError(
    dict.fromkeys(
        ResponsePoint,
        replace(DEFAULT_SPECTRUM, frequency=(100.0, 1000.0), deviation=(2e-4, 2e-4), frequency_tolerance=(1e-6, 1e-6)),
    )
)


#: As it is measured at its two preloads.
SIZES = sizes_of_drive(
    physics_of(AXIS), [ModalObservation(DriveConditions(0.5, preload), 200.0) for preload in (120.0, 300.0)]
)


def settings(positions=POSITIONS, preloads=(120.0, 300.0), **changes):
    return [DriveConditions(position, preload, **changes) for position in positions for preload in preloads]


def measured(physics_at, conditions, *, seed=0, noise=NOISE, excitation=ExcitationPoint.TORQUE_AT_SCREW,
             response=ResponsePoint.ACCELERATION_AT_TABLE, lines=LINES):  # fmt: skip
    """Return responses with noise, of settings that are not quite as stated.

    Parameters
    ----------
    physics_at : AxisPhysics, or callable
        The axis, or from conditions to the axis as it is then.
    conditions : sequence of DriveConditions
        As stated.
    """
    rng, tolerances = np.random.default_rng(seed), SettingTolerances()
    end = motor_end_of(excitation, MotorEnd.FREE)
    observations = []
    for stated in conditions:
        physics = physics_at(stated) if callable(physics_at) else physics_at
        position, share, gain = rng.standard_normal(3)
        true = replace(
            stated,
            position=stated.position + tolerances.position * position,
            preload=stated.preload * (1.0 + tolerances.preload_share * share),
        )
        case = ResponseCase(lines, true, excitation, response, end)
        clean = responses(physics, prepare_lines([case]))
        scatter = rng.standard_normal(lines.size) + 1j * rng.standard_normal(lines.size)
        observations.append(
            FrequencyResponseObservation(
                stated,
                lines,
                clean * (1.0 + tolerances.gain_share * gain) + noise * np.abs(clean) * scatter,
                noise * np.abs(clean),
                excitation,
                response,
            )
        )
    return observations


def compared(observations, **options):
    """Return the comparison, with the folds that the workflow takes."""
    folds = default_folds(observation.conditions for observation in observations)
    return compare_responses(observations, **({"held_out": folds, "form": FORM} | options))


def subject(**changes):
    """Return the axis as described."""
    return DescribedDrive(replace(AXIS, **changes), TOLERANCES, {})


def true_subject(seed=0):
    """Return the physics of the axis with its uncertain parameters drawn."""
    rng = np.random.default_rng([seed, 1])
    return subject().physics({name: 0.5 * tolerance * rng.standard_normal() for name, tolerance in TOLERANCES.items()})


@cache
def effects_by_key():
    physics = subject().physics({})
    return {effect.key: effect for effect in sized_for(DRIVE_EFFECTS, SIZES) if effect.applies(physics)}
