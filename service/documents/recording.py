"""What an uploaded recording holds, as it is stored with its row and answered."""

from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True)


class FileEntry(_Entry):
    """A file as it was sent."""

    name: str
    size_bytes: int
    sha256: str


class ChannelEntry(_Entry):
    """A channel, with what its file says of it."""

    file: str
    name: str
    shape: list[int]
    unit: str | None
    sample_rate_hz: float | None
    started_at: datetime | None


class LeftOutEntry(_Entry):
    """Something that became no window."""

    what: str
    why: str


class RecordingContents(_Entry):
    """What was found in a recording before its windows were taken."""

    axis_id: str = Field(description="as the recording says")
    session: str = Field(description="where the session lies in the folder of the recording")
    n_windows: int
    n_measurements: int
    files: list[FileEntry]
    channels: list[ChannelEntry]
    left_out: list[LeftOutEntry]
