"""Read and write files, one format each: the only file access in the core (ISO 13374: DA).

Nothing is guessed: no default unit, no default sampling rate, no time without a zone. What does not fit is refused with
one sentence (:class:`monitor_core.errors.RecordingFormatError`): what was expected, what was got, where.
``docs/reference/recordings.md`` shows each format with an example. The names
below are imported from their modules when they are first used: a format pays for what it needs alone.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from monitor_core.recordings.calibration_file import (
        read_calibration as read_calibration,
        write_calibration as write_calibration,
    )
    from monitor_core.recordings.check import FileReport as FileReport, check_file as check_file
    from monitor_core.recordings.frf_set import read_frf_set as read_frf_set, write_frf_set as write_frf_set
    from monitor_core.recordings.modal_csv import (
        ModalRow as ModalRow,
        read_modal_table as read_modal_table,
        write_modal_table as write_modal_table,
    )
    from monitor_core.recordings.model_file import (
        read_model_file as read_model_file,
        write_model_file as write_model_file,
    )
    from monitor_core.recordings.motion_csv import (
        read_motion_profile as read_motion_profile,
        read_motion_record as read_motion_record,
        write_motion_record as write_motion_record,
    )
    from monitor_core.recordings.raw.channels import Channel as Channel, Channels as Channels
    from monitor_core.recordings.raw.formats import read_channels as read_channels
    from monitor_core.recordings.raw.mapping.channel_map import read_channel_map as read_channel_map
    from monitor_core.recordings.raw.mapping.imported import (
        ImportedSession as ImportedSession,
        import_session as import_session,
    )
    from monitor_core.recordings.raw.mapping.map_records import ChannelMap as ChannelMap
    from monitor_core.recordings.session_hdf5 import (
        SessionReader as SessionReader,
        open_session as open_session,
        read_session as read_session,
        write_session as write_session,
    )

_HOMES = {
    "calibration_file": ("read_calibration", "write_calibration"),
    "check": ("FileReport", "check_file"),
    "frf_set": ("read_frf_set", "write_frf_set"),
    "modal_csv": ("ModalRow", "read_modal_table", "write_modal_table"),
    "model_file": ("read_model_file", "write_model_file"),
    "motion_csv": ("read_motion_profile", "read_motion_record", "write_motion_record"),
    "raw.channels": ("Channel", "Channels"),
    "raw.formats": ("read_channels",),
    "raw.mapping.channel_map": ("read_channel_map",),
    "raw.mapping.imported": ("ImportedSession", "import_session"),
    "raw.mapping.map_records": ("ChannelMap",),
    "session_hdf5": ("SessionReader", "open_session", "read_session", "write_session"),
}
_HOME_OF = {name: f"{__name__}.{module}" for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME_OF})
