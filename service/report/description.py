"""Say what was described: where it sits, which quantity varies by which law, or what swings there."""

from monitor_core.discrepancy import Described
from monitor_core.effects import Form, Law, Variable
from service.report.rounding import rounded

_VARIABLES = {
    Variable.EXCITATION: ("the excitation", 1.0, ""),
    Variable.POSITION: ("the position", 1e3, " mm"),
    Variable.PRELOAD: ("the preload", 1.0, " N"),
    Variable.PAYLOAD: ("the payload", 1.0, " kg"),
    Variable.TEMPERATURE: ("the temperature", 1.0, " K"),
    Variable.ORDER: ("the order of measurement", 1.0, ""),
}


def described_sentence(found: Described) -> str:
    """Return what varies where, with what and by which law; or what swings there; or that no law says how."""
    or_else = (
        f" (or {' or '.join(found.alternatives)}, which these data do not distinguish)" if found.alternatives else ""
    )
    if found.has_no_form:
        least, most = (rounded(end(found.factors.values()), 3) for end in (min, max))
        return (
            f"{found.parameter} at the {found.place}{or_else} would have to be another one at each setting, {least} to "
            f"{most} times what it is, by no law that was tried"
        )
    swings = _swings(found) or _bends(found)
    if found.law is None:
        return f"{swings}{or_else}, the same at every setting"
    with_what, factor, unit = _VARIABLES[found.law.variable]
    what = f"{swings}; its {found.parameter}" if swings else f"{found.parameter} at the {found.place}"
    return f"{what} varies with {with_what}{or_else}, as {_law(found, found.law, factor, unit)}{_at_end(found)}"


def _at_end(found: Described) -> str:
    """Say which coefficients stand at an end of the range that is searched: the form may be another; else nothing."""
    ends = " and ".join(name.replace("_", " ") for name, value in found.parameters.items() if value.at_end)
    return f"; its {ends} would go beyond what is searched, so that the form is only the nearest tried" if ends else ""


def _swings(found: Described) -> str:
    """Return what swings there on a spring; empty where nothing does."""
    size, unit = (found.mass_kg, "kg") if found.inertia_kg_m2 is None else (found.inertia_kg_m2, "kg·m²")
    if found.frequency_hz is None or size is None:
        return ""
    return f"something of {rounded(size, 3)} {unit} on a spring, {rounded(found.frequency_hz, 4)} Hz, hangs on the " + (
        found.place
    )


def _bends(found: Described) -> str:
    """Return how the screw bends; empty where it does not."""
    if found.place != "screw" or found.frequency_hz is None:
        return ""
    size = found.parameters.get("compliance_m_per_n")
    yields = "" if size is None else f", by up to {rounded(1e9 * size.estimate.value, 3)} nm/N along it"
    return f"the screw bends under the force in the nut{yields}, first at {rounded(found.frequency_hz, 4)} Hz"


def _law(found: Described, law: Law, factor: float, unit: str) -> str:
    values = found.parameters
    reference, scale = f"{rounded(factor * law.reference, 3)}{unit}", f"{rounded(factor * law.scale, 3)}{unit}"

    def shown(name: str) -> str:
        value, (low, high) = values[name].estimate.value, values[name].interval_95
        return f"({rounded(value, 2)}; 95 %: {rounded(low, 2)} to {rounded(high, 2)})"

    u = f"u = (x − {reference})/{scale}"
    match law.form:
        case Form.LINEAR:
            return f"1 + {shown('change')} u with {u}"
        case Form.QUADRATIC:
            return f"1 + {shown('change')} u + {shown('curvature')} u² with {u}"
        case Form.PERIODIC:
            return f"1 + {shown('cosine')} cos φ + {shown('sine')} sin φ with φ = 2πx/{scale}"
        case Form.YIELDING:
            wave = f"{shown('cosine')} cos φ + {shown('sine')} sin φ"
            return f"1/(1 + c + {wave}) with φ = 2πx/{scale}, and c so that it is as stated at one angle"
        case Form.POWER:
            return f"the power {shown('exponent')} of x/{reference}"
        case Form.SATURATING:
            return f"1 + {shown('change')} x/(x + h) with h = {shown('half_at')} × {scale}"
