"""Say of which axes the history is being judged anew: until that is done they say what they said."""

from dataclasses import dataclass

from sqlalchemy.orm import Session

from service.store.rejudged import unfinished_of


@dataclass(frozen=True, slots=True)
class Stale:
    """The job that judges a history anew, and by which calibration."""

    job: str
    calibration: int


def stale_axes(session: Session, axis_id: str | None = None) -> dict[str, Stale]:
    """Return the axes whose values are about to be replaced, all or one of them; dry runs replace nothing."""
    return {
        row.axis_id: Stale(row.id, calibration)
        for row in unfinished_of(session, axis_id)
        if row.axis_id is not None
        and not row.arguments.get("dry_run")
        and isinstance(calibration := row.arguments.get("calibration"), int)
    }
