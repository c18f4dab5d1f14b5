"""Read and write files, one format each: the only file access in the core (ISO 13374: DA).

Nothing is guessed: no default unit, no default sampling rate, no time without a zone. What does not fit is refused with
one sentence (:class:`monitor_core.errors.RecordingFormatError`): what was expected, what was got, where.
``docs/reference/recordings.md`` shows each format with an example.
"""

from monitor_core.recordings.calibration_file import read_calibration, write_calibration
from monitor_core.recordings.check import FileReport, check_file
from monitor_core.recordings.frf_set import read_frf_set, write_frf_set
from monitor_core.recordings.modal_csv import ModalRow, read_modal_table, write_modal_table
from monitor_core.recordings.model_file import read_model_file, write_model_file
from monitor_core.recordings.motion_csv import read_motion_record, write_motion_record
from monitor_core.recordings.raw.channels import Channel, Channels
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.mapping.channel_map import ChannelMap, read_channel_map
from monitor_core.recordings.raw.mapping.imported import ImportedSession, import_session
from monitor_core.recordings.session_hdf5 import SessionReader, open_session, read_session, write_session

__all__ = [
    "Channel",
    "ChannelMap",
    "Channels",
    "FileReport",
    "ImportedSession",
    "ModalRow",
    "SessionReader",
    "check_file",
    "import_session",
    "open_session",
    "read_calibration",
    "read_channel_map",
    "read_channels",
    "read_frf_set",
    "read_modal_table",
    "read_model_file",
    "read_motion_record",
    "read_session",
    "write_calibration",
    "write_frf_set",
    "write_modal_table",
    "write_model_file",
    "write_motion_record",
    "write_session",
]
