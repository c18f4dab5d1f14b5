"""How numbers, moments and ages are written in the language of a page: filters of the templates."""

import math
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Any

from jinja2 import Environment, pass_context
from jinja2.runtime import Context
from markupsafe import Markup, escape

from monitor_core.uncertainty import plus_minus
from service.clock import now
from service.documents.measurement import shares_in_words
from service.documents.said import N_, PlusMinus, Said, Sentence, Stated, Value
from service.report.rounding import UNKNOWN, notation
from service.web.words import Words


def decimal(words: Words, text: str) -> str:
    """Return a number as this language writes it: with its own decimal mark."""
    return text.replace(".", words.decimal).replace("-", "−")


def number(words: Words, value: float | None, digits: int = 3) -> str:
    """Show a number with so many significant digits."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    chosen = notation(value, math.nan, digits)
    return decimal(words, chosen.mantissa(value) + chosen.power)


def plain(words: Words, value: float | None, digits: int = 3) -> str:
    """Show a number with so many significant digits at most: without zeros at its end, as a limit is written."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    return decimal(words, f"{value:.{digits}g}") if 1e-4 <= abs(value) < 10**digits else number(words, value, digits)


def percent(words: Words, share: float) -> str:
    """Show a share in percent; of one that is next to nothing, that it is."""
    least = 1e-4
    if 0.0 < share < least:
        return words(N_("less than %(share)s %%")) % {"share": number(words, 100.0 * least, 1)}
    return f"{number(words, 100.0 * share, 2 if share < 1.0 else 3)} %"


def with_interval(words: Words, value: float | None, interval: Sequence[float | None] | None) -> tuple[str, str]:
    """Return a value and half the width of its 95 % interval, with the digits that it warrants; "" if it is open."""
    if value is None:
        return UNKNOWN, ""
    lower, upper = interval or (None, None)
    if lower is None or upper is None:
        return number(words, value), ""
    text, _, half = plus_minus(value, (upper - lower) / 2.0).partition(" ± ")
    return decimal(words, text), decimal(words, half)


def uncertain(words: Words, value: float, uncertainty: float) -> str:
    """Show a value with its uncertainty, or half of its interval."""
    return decimal(words, plus_minus(value, uncertainty))


def _moment(value: datetime | str) -> datetime:
    return datetime.fromisoformat(value) if isinstance(value, str) else value


def when(value: datetime | str | None) -> str | Markup:
    """Show a moment to the minute in UTC; a browser with a script turns it into its own zone."""
    if value is None:
        return UNKNOWN
    moment = _moment(value).astimezone(UTC)
    stated = moment.isoformat().replace("+00:00", "Z")
    return Markup(f'<time datetime="{stated}" data-local>{moment:%Y-%m-%d %H:%M} UTC</time>')  # noqa: S704 - digits


def day(value: datetime | str | None) -> str | Markup:
    """Show the day of a moment."""
    if value is None:
        return UNKNOWN
    moment = _moment(value).astimezone(UTC)
    return Markup('<time datetime="{}">{}</time>').format(moment.isoformat(), moment.strftime("%Y-%m-%d"))


def age(words: Words, value: datetime | str | None) -> str | Markup:
    """Show how long ago something was; a browser with a script goes on counting."""
    if value is None:
        return UNKNOWN
    from babel.dates import format_timedelta  # noqa: PLC0415  # a start needs no ages

    moment = _moment(value)
    passed = format_timedelta(moment - now(), add_direction=True, format="short", locale=words.locale)
    return Markup('<time datetime="{}" data-age>{}</time>').format(moment.isoformat().replace("+00:00", "Z"), passed)


def say(words: Words, said: Said | None) -> Markup:
    """Write a sentence in the language of the page, its numbers and moments as that writes them."""
    if said is None:
        return Markup()
    values = {name: _said(words, value) for name, value in said.values.items()}
    return Markup(str(escape(words(said.text))) % values)  # noqa: S704 - text and values are escaped


def _said(words: Words, value: Value) -> str | Markup:
    if isinstance(value, datetime):
        return day(value)
    if isinstance(value, Sentence):
        return words.told(value)
    if isinstance(value, Stated):
        return stated(words, value)
    if isinstance(value, PlusMinus):
        return uncertain(words, value.value, value.half)
    if isinstance(value, float):
        value = number(words, value, 2)
    return escape(value)


def stated(words: Words, value: float) -> str:
    """Show a number that somebody stated, with all its digits."""
    return decimal(words, f"{value:.10g}")


def install(environment: Environment) -> None:
    """Give the filters to templates; the words of the page are in what it is written from."""

    def spoken(write: Callable[..., object]) -> Callable[..., object]:
        @pass_context
        def in_words_of_page(context: Context, /, *arguments: Any, **values: Any) -> object:  # noqa: ANN401 - any filter's
            return write(context["words"], *arguments, **values)

        return in_words_of_page

    def plural(words: Words, one_of_it: str, several: str, n: int, /, **values: object) -> Markup:
        return Markup(words.texts.ngettext(one_of_it, several, n)) % (values | {"num": n})  # noqa: S704 - a template's

    environment.filters |= {
        "number": spoken(number),
        "stated": spoken(stated),
        "plain": spoken(plain),
        "percent": spoken(percent),
        "with_interval": spoken(with_interval),
        "uncertain": spoken(uncertain),
        "age": spoken(age),
        "say": spoken(say),
        "when": when,
        "day": day,
        "shares": shares_in_words,
        "translated": spoken(Words.__call__),
        "called": spoken(Words.called),
        "told": spoken(Words.told),
    }
    environment.newstyle_gettext = True  # type: ignore[attr-defined]  # values of {% trans %} come as arguments
    environment.globals |= {"_": spoken(Words.marked), "gettext": spoken(Words.marked), "ngettext": spoken(plural)}
