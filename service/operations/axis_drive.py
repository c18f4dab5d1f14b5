"""The drive model that the configuration of an axis may hold."""

from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.described_axis import DescribedDrive
from monitor_core.recordings.model_file import parse_model


def axis_drive(text: str) -> DescribedDrive:
    """Return the drive that a model describes as TOML, which must be one whose nut follows its preload.

    Raises RecordingFormatError or OutsideValidityError if it is no drive model, or has a nut of one rigidity: no change
    of the preload could be thought of.
    """
    description = parse_model(text, "drive_model")
    drive = description.drive()
    if not description.nut_follows_preload:
        raise OutsideValidityError(
            "drive_model: expected dynamic_load_rating_n in [parameters], by which the nut follows its preload; got "
            "none"
        )
    return drive
