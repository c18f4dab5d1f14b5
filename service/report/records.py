"""Say which records are wrong, and in what."""

from collections.abc import Iterator
from typing import Final

from monitor_core.discrepancy import Explanation, RecordFault, WrongRecord
from service.report.rounding import rounded

#: What is wrong, and what more and less of it is called.
_TAGS: Final = {
    RecordFault.POSITION: ("its position is", "further than", "short of what is"),
    RecordFault.PRELOAD: ("its preload is", "higher than", "lower than"),
    RecordFault.PAYLOAD: ("its payload is", "more than", "less than"),
    RecordFault.TEMPERATURE: ("it is", "warmer than", "colder than"),
}


def record_sentences(explanation: Explanation) -> Iterator[str]:
    """Yield a sentence for each record that does not go with the others."""
    for record in explanation.records:
        yield (
            f"Record {record.number} ({record.setting}) is wrong: {_fault(record)} (ΔBIC {rounded(record.delta_bic)}). "
            "It was taken out, and what is said here rests on the others."
        )


def _fault(record: WrongRecord) -> str:
    uncertainty = rounded(record.standard_uncertainty, 2)
    if record.fault is RecordFault.OUTLIER:
        return (
            f"it is {rounded(record.misfit, 2)} standard deviations from what the others say, and no tag and no gain "
            "explains that"
        )
    if record.fault is RecordFault.GAIN:
        return f"its gain is {rounded(record.found)} ± {uncertainty} times what it should be"
    what, more, less = _TAGS[record.fault]
    change = record.found - record.stated
    return f"{what} {rounded(abs(change))} ± {uncertainty} {record.unit} {more if change > 0.0 else less} stated"
