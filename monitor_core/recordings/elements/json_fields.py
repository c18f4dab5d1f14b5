"""Read named values of a JSON document: objects, lists, numbers; what does not fit is refused with its place."""

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.fields import Fields


def json_object(value: object, where: str) -> Fields:
    """Return the keys of a JSON object; null means the same as a key that is not there."""
    if not isinstance(value, dict):
        raise RecordingFormatError(f"{where}: expected a JSON object; got {type(value).__name__}")
    return Fields({key: entry for key, entry in value.items() if entry is not None}, where)


def json_table(fields: Fields, name: str) -> Fields:
    """Return the keys of an object inside another."""
    return json_object(fields.values.get(name), f"{fields.where}, {name}")


def json_list(fields: Fields, name: str) -> list[object]:
    """Return a list by its key."""
    value = fields.values.get(name)
    if not isinstance(value, list):
        raise RecordingFormatError(f"{fields.where}, {name}: expected a list; got {type(value).__name__}")
    return value


def json_numbers(values: object, n: int, place: str) -> list[float]:
    """Return so many finite numbers."""
    if not isinstance(values, list) or len(values) != n:
        raise RecordingFormatError(f"{place}: expected a list of {n} numbers; got {values!r:.60}")
    return [Fields({"item": value}, place).number("item", "SI") for value in values]
