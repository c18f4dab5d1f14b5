"""Say what was described: where it sits, which quantity varies, and by which law."""

from monitor_core.discrepancy import Described
from monitor_core.effects import Form, Variable
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
    """Return what varies, where, with what and by which law."""
    with_what, factor, unit = _VARIABLES[found.law.variable]
    what = f"{found.parameter} at the {found.place}"
    if found.frequency_hz is not None and found.mass_kg is not None:
        mass, frequency = rounded(found.mass_kg, 3), rounded(found.frequency_hz, 4)
        what = f"something of {mass} kg on a spring, {frequency} Hz, hangs on the {found.place}; its {found.parameter}"
    or_else = (
        f" (or {' or '.join(found.alternatives)}, which these data do not distinguish)" if found.alternatives else ""
    )
    return f"{what} varies with {with_what}{or_else}, as {_law(found, factor, unit)}"


def _law(found: Described, factor: float, unit: str) -> str:
    law, values = found.law, found.parameters
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
        case Form.POWER:
            return f"the power {shown('exponent')} of x/{reference}"
        case Form.SATURATING:
            return f"1 + {shown('change')} x/(x + h) with h = {shown('half_at')} × {scale}"
