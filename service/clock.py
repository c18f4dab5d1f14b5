"""Read the time, and write moments: the only place where the service does."""

from datetime import UTC, datetime


def now() -> datetime:
    """Return the present moment in UTC."""
    return datetime.now(UTC)


def text_of(moment: datetime) -> str:
    """Return a moment as it is written everywhere: RFC 3339 in UTC, with Z, microseconds where there are any."""
    return moment.astimezone(UTC).isoformat().replace("+00:00", "Z")
