"""Read and write files, one format each: the only file access in the core (ISO 13374: DA).

Nothing is guessed: no default unit, no default sampling rate, no time without a zone. What does not fit is refused with
one sentence (:class:`monitor_core.errors.RecordingFormatError`): what was expected, what was got, where.
``docs/reference/recordings.md`` shows each format with an example.
"""

from monitor_core.recordings.check import FileReport, check_file
from monitor_core.recordings.modal_csv import ModalRow, read_modal_table, write_modal_table
from monitor_core.recordings.raw.channel_map import ChannelMap, read_channel_map
from monitor_core.recordings.raw.channels import Channel, Channels
from monitor_core.recordings.raw.mapped import read_channels, read_mapped
from monitor_core.recordings.session_hdf5 import SessionReader, open_session, read_session, write_session

__all__ = [
    "Channel",
    "ChannelMap",
    "Channels",
    "FileReport",
    "ModalRow",
    "SessionReader",
    "check_file",
    "open_session",
    "read_channel_map",
    "read_channels",
    "read_mapped",
    "read_modal_table",
    "read_session",
    "write_modal_table",
    "write_session",
]
