"""Text files that other programs wrote: what their columns hold, and how each is proposed to be read."""

import numpy as np
import pytest

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.text.layout import TextLayout
from monitor_core.recordings.raw.text.proposal import propose
from tests.conftest import canary


@pytest.mark.parametrize("number", canary(range(7)))
def test_a_labview_spreadsheet_is_read_with_the_layout_that_is_proposed(measured_data, number):
    path = measured_data / "dropbear" / f"slow10_test{number}.txt"
    with pytest.raises(RecordingFormatError, match="5 rows above its names, a row of units and rows between"):
        read_channels(path)
    layout = propose(path).layout
    assert layout == TextLayout("tab", header_row=6, unit_row=7, first_row=10)
    channels = read_channels(path, layout)
    assert channels.names == ("Low G Accel", "Accel", "PinLoc", "Time")
    times = channels.channel("Time")
    assert times.unit == "Sec"
    # 14 s at 5 kHz, printed to six digits
    np.testing.assert_allclose(times.samples, np.arange(70_000) / 5000.0, rtol=0.0, atol=5.1e-5)


@pytest.mark.parametrize(
    ("name", "n_channels", "n_samples"),
    [("tool_frf/Point_1_Channel_1_CH1.txt", 3, 5001), ("tool_frf/Impact_Point1_Channel1_CH1.txt", 3, 51_200),
     ("xjtu_ballscrew/Up_FT.txt", 1, 30), ("xjtu_ballscrew/Down_FT.txt", 1, 30)],
)  # fmt: skip
def test_plain_columns_need_no_layout(measured_data, name, n_channels, n_samples):
    assert not propose(measured_data / name).reasons
    channels = read_channels(measured_data / name)
    assert [channel.samples.size for channel in channels.channels] == [n_samples] * n_channels
