"""Name the unit of a frequency response: excitation and response imply it; it is compared, never converted."""

from monitor_core.models.protocol import ExcitationPoint, ResponsePoint

_RESPONSE_UNITS = {
    ResponsePoint.ACCELERATION_AT_TABLE: "m/s2",
    ResponsePoint.ACCELERATION_AT_NUT: "m/s2",
    ResponsePoint.DISPLACEMENT_AT_TABLE: "m",
    ResponsePoint.ANGLE_AT_MOTOR: "rad",
}
#: Other signs for powers and products; no spelling of a quotient of units is common to all writers.
_SIGNS = str.maketrans({"^": None, " ": None, "²": "2", "·": ".", "⋅": ".", "*": "."})


def excitation_unit(excitation: ExcitationPoint) -> str:
    """Return the unit of what drives the axis there."""
    return "N" if excitation is ExcitationPoint.FORCE_AT_TABLE else "N.m"


def response_unit(excitation: ExcitationPoint, response: ResponsePoint) -> str:
    """Return the unit that two points imply, as files spell it: ``m/(N.m.s2)``, ``m/N``, ``rad/(N.m)``, …."""
    per = excitation_unit(excitation)
    if response.is_acceleration:
        return f"m/({per}.s2)"
    return f"{_RESPONSE_UNITS[response]}/{'N' if per == 'N' else '(N.m)'}"


def is_response_unit(text: str, excitation: ExcitationPoint, response: ResponsePoint) -> bool:
    """Tell whether a text spells the unit; ``m/s2/N.m`` divides by the newton metre, as people write."""
    plain = text.replace("**", "").translate(_SIGNS).replace("Nm", "N.m")
    of, per = _RESPONSE_UNITS[response], excitation_unit(excitation)
    quotients = {f"{above}/{below}" for above in (of, f"({of})") for below in (per, f"({per})")}
    if response.is_acceleration:
        quotients |= {f"m/({per}.s2)", f"m/(s2.{per})"}
    return plain in quotients
