"""A value with its uncertainty has two significant digits of that, whichever face shows it (GUM, 7.2.6)."""

import re
from decimal import ROUND_HALF_EVEN, Context, Decimal
from pathlib import Path

import numpy as np

from monitor_core.uncertainty import plus_minus
from service.documents.said import PlusMinus, Said, in_english
from service.report.rounding import with_uncertainty
from service.web.shown import say, uncertain, with_interval
from service.web.words import words_for

ROOT = Path(__file__).resolve().parents[2]
TWO_DIGITS = Context(prec=2, rounding=ROUND_HALF_EVEN)


def test_two_digits_of_the_uncertainty_show_and_as_many_decimals_of_the_value() -> None:
    """Against decimal arithmetic, over values and uncertainties of twelve decades, those that round up to ten too."""
    rng = np.random.default_rng(576)
    drawn = 10.0 ** rng.uniform(-6.0, 6.0, (2000, 2)) * rng.choice([-1.0, 1.0], (2000, 2))
    for value, uncertainty in [*drawn.tolist(), (1.0, 0.0996), (1.0, 9.96), (0.924, 0.000982), (155.074, 0.0004)]:
        shown, half = (Decimal(text) for text in plus_minus(value, abs(uncertainty)).split(" ± "))
        rounded = TWO_DIGITS.create_decimal(repr(abs(uncertainty)))
        last = Decimal(1).scaleb(rounded.adjusted() - 1)
        assert abs(half - rounded) <= Decimal("1e-9") * rounded or abs(half - Decimal(abs(uncertainty))) <= last / 2
        assert half % last == 0
        assert abs(shown - Decimal(value)) <= last * Decimal("0.5000001")
        assert shown % last == 0


def test_what_is_not_known_stands_alone() -> None:
    for uncertainty in (0.0, float("nan"), float("inf")):
        assert plus_minus(155.0744, uncertainty) == "155"


def test_all_faces_show_the_same_digits() -> None:
    words = words_for("en")
    for value, half in ((204.04, 1.42), (200.4, 13.2), (0.924, 0.000982), (12.0, 0.0996)):
        plain = plus_minus(value, half)
        said = Said("%(it)s %%", {"it": PlusMinus(value, half)})
        assert in_english(said) == f"{plain} %" == str(say(words, said))
        assert with_uncertainty(value, half) == plain == uncertain(words, value, half)
        assert " ± ".join(with_interval(words, value, (value - half, value + half))) == plain


def test_no_other_line_of_the_program_decides_how_many_digits_an_uncertainty_has() -> None:
    of_its_own = re.compile(r"± ?(\{[^}]*:[^}]*\}|\{\{[^}]*\| ?number)")
    found = [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for folder in ("monitor_core", "service", "preload_client")
        for kind in ("*.py", "*.html")
        for path in (ROOT / folder).rglob(kind)
        for line in path.read_text(encoding="utf-8").splitlines()
        if path.name != "uncertainty.py" and of_its_own.search(line)
        if "must lie within" not in line and "piles up at" not in line
    ]
    assert found == []
