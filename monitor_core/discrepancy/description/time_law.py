"""Ask whether a nut that changes from one measurement to the next would do as well as what was found.

Settings are measured one after the other. What the preload loses or gains meanwhile goes along with positions, preloads
and temperatures as far as these come in an order, and an effect that follows them explains it, too.
"""

from collections.abc import Callable
from typing import Any, Final

from monitor_core.discrepancy.description.answers import is_evident
from monitor_core.discrepancy.description.bases import Base
from monitor_core.discrepancy.description.describe import refit_with_law
from monitor_core.discrepancy.description.free_variation import fitted_settings, vary_freely
from monitor_core.discrepancy.description.laws import tried_laws
from monitor_core.discrepancy.description.quantities import QUANTITIES
from monitor_core.discrepancy.verdict.amplitude import PRELOAD_EXPONENT, WRONG_NUT_STIFFNESS
from monitor_core.effects import Variable
from monitor_core.fitting.evidence import delta_bic
from monitor_core.fitting.hold_out import gain
from monitor_core.fitting.solver.hypothesis_fit import Fitted
from monitor_core.models.extended import AxisPhysics

#: What changes the stiffness of the nut from setting to setting.
OF_NUT: Final = frozenset({"periodic-preload", "thermal-preload", PRELOAD_EXPONENT, WRONG_NUT_STIFFNESS})
_NUT_STIFFNESS = next(each for each in QUANTITIES if each.field == "nut_stiffness")
_REFITS = 2


def goes_with_time(without: Fitted[Any], final: Fitted[Any], margin: float, progress: Callable[[str], None]) -> bool:
    """Return whether a law of time of the nut's stiffness does as well as an effect, within a ``margin`` of BIC.

    ``without`` is the fit without the effect and ``final`` that with it. The law has to gain on held-out data, too. It
    need not explain most of what is missing: the effect need not either, beside settings that scatter.
    """
    axis = without.physics()
    if not isinstance(axis, AxisPhysics):
        return False
    progress("asking whether it changes with time")
    variation = vary_freely(without, _NUT_STIFFNESS)
    if variation is None:
        return False
    tried = tried_laws(variation, fitted_settings(without), axis.screw.lead)
    of_time = [each for each in tried if each.law.variable is Variable.ORDER]
    answers = (refit_with_law(Base(without), each, progress) for each in of_time[:_REFITS])
    return any(
        answer is not None
        and is_evident(answer)
        and not gain(without.held_out, answer.fitted.held_out, answer.scale) <= 0.0  # NaN: nothing is held out
        and delta_bic(final, answer.fitted, answer.scale) >= -margin
        for answer in answers
    )
