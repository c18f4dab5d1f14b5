"""Write numbers and ratios as a person reads them: as many digits as their uncertainty warrants."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from monitor_core.uncertainty import decimals_of

UNKNOWN: Final = "—"
TIMES: Final = 1.5  # from this ratio on people say "times"

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True, slots=True)
class Notation:
    """Power of ten that is split off, and how many decimals are left."""

    exponent: int
    decimals: int

    def mantissa(self, value: float) -> str:
        """Show what stands before the power of ten."""
        if math.isnan(value):
            return UNKNOWN
        if math.isinf(value):
            return "∞" if value > 0.0 else "−∞"
        shown = round(value / 10.0**self.exponent, self.decimals) + 0.0  # no minus before a zero
        return f"{shown:.{max(self.decimals, 0)}f}".replace("-", "−")

    @property
    def power(self) -> str:
        """Show the power of ten, with the sign of multiplication before it; empty where there is none."""
        return f" × 10{str(self.exponent).translate(_SUPERSCRIPTS)}" if self.exponent else ""


def notation(value: float, uncertainty: float, digits: int = 3) -> Notation:
    """Return the notation in which two digits of the uncertainty show, or so many digits of the value."""
    known = math.isfinite(uncertainty) and uncertainty > 0.0
    largest = max(abs(value), uncertainty if known else 0.0)
    if largest == 0.0:
        return Notation(0, 0)
    last = -decimals_of(uncertainty) if known else _decade(value) + 1 - digits
    exponent = 0 if 1e-2 <= largest < 1e4 else 3 * math.floor(_decade(largest) / 3)
    return Notation(exponent, min(exponent - last, 6))


def rounded(value: float, digits: int = 3) -> str:
    """Show a number with so many digits."""
    if not math.isfinite(value):
        return Notation(0, 0).mantissa(value)
    chosen = notation(value, math.nan, digits)
    return chosen.mantissa(value) + chosen.power


def tick(value: float) -> str:
    """Show a number at an axis, where there is little room."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.5g}".replace("-", "−")
    mantissa, _, exponent = f"{value:.2e}".partition("e")
    mantissa = mantissa.rstrip("0").rstrip(".").replace("-", "−")
    power = f"10{str(int(exponent)).translate(_SUPERSCRIPTS)}"
    return power if mantissa == "1" else f"{mantissa}·{power}"


def evidence(value: float) -> str:
    """Show a difference of log-likelihoods or of BIC, of which a tenth is all that matters."""
    return Notation(0, 1).mantissa(value)


def with_uncertainty(value: float, uncertainty: float) -> str:
    """Show a value with its standard uncertainty."""
    chosen = notation(value, uncertainty)
    if not math.isfinite(uncertainty):
        return f"{rounded(value)} (uncertainty not known)"
    both = f"{chosen.mantissa(value)} ± {chosen.mantissa(uncertainty)}"
    return f"({both}){chosen.power}" if chosen.power else both


def between(lower: float, upper: float, chosen: Notation) -> str:
    """Show an interval."""
    both = f"{chosen.mantissa(lower)} to {chosen.mantissa(upper)}"
    return f"({both}){chosen.power}" if chosen.power else both


def bound(lower: float, upper: float, shown: Callable[[float], str]) -> str:
    """Say an interval without an end: "at least 16 times as much"; empty where it has both ends."""
    if math.isfinite(lower) == math.isfinite(upper):
        return ""
    words = shown(lower if math.isinf(upper) else upper)
    at_least = math.isinf(upper) != (" less" in words)  # more of "less" is less
    return f"at {'least' if at_least else 'most'} {words}"


def unit_shown(unit: str) -> str:
    """Show a unit after a number: nothing where it has none, σ for standard deviations."""
    return {"-": "", "": "", "sigma": " σ", "%": " %"}.get(unit, f" {unit}")


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Show a number with its unit."""
    return UNKNOWN if math.isnan(value) else rounded(value, digits) + unit_shown(unit)


def probability(p_value: float) -> str:
    """Show a p-value; a very small one by its bound, since its digits mean nothing."""
    if math.isnan(p_value):
        return UNKNOWN
    return "< 0.0001" if p_value < 1e-4 else f"{p_value:.2g}"


def ratio_words(ln_ratio: float) -> str:
    """Say a ratio to what is stated, known by its logarithm: "13 % more", "3.0 times as much"."""
    ratio = math.exp(ln_ratio)
    if 1.0 / TIMES < ratio < TIMES:
        return f"{rounded(abs(100.0 * (ratio - 1.0)), 2)} % {'more' if ln_ratio >= 0.0 else 'less'}"
    return f"{rounded(ratio, 2)} times as much"


def compared_with_stated(ln_ratio: float) -> str:
    """Say a ratio in a sentence: "13 % more than stated", "3.0 times what is stated"."""
    words = ratio_words(ln_ratio)
    return words.replace("times as much", "times what is stated") if "times" in words else f"{words} than stated"


def ratio_with_uncertainty(ln_ratio: float, uncertainty: float) -> str:
    """Say a ratio with its standard uncertainty: "(12.70 ± 0.40) % more"; large ones as times."""
    ratio = math.exp(ln_ratio)
    spread = ratio * uncertainty
    if not math.isfinite(spread):
        return f"{ratio_words(ln_ratio)} (uncertainty not known)"
    if 1.0 / TIMES < ratio < TIMES:
        change = abs(100.0 * (ratio - 1.0))
        return f"({with_uncertainty(change, 100.0 * spread)}) % {'more' if ln_ratio >= 0.0 else 'less'}"
    return f"({with_uncertainty(ratio, spread)}) times as much"


def ratio_interval(low: float, high: float) -> str:
    """Say both ends of an interval of a ratio, known by their logarithms."""
    return f"{ratio_words(low)} to {ratio_words(high)}"


def _decade(value: float) -> int:
    return math.floor(math.log10(abs(value))) if value else 0
