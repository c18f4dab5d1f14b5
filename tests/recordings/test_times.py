"""Texts of dates and times: seconds and start against the calendar of ``datetime`` and against closed forms."""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
from hypothesis import given, strategies as st

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.raw.mapping.times import times_of, zone_of

CET = timezone(timedelta(hours=1))
FORMATS = {
    "iso": lambda moment: moment.isoformat(timespec="microseconds"),
    "%d.%m.%Y %H:%M:%S.%f": lambda moment: moment.strftime("%d.%m.%Y %H:%M:%S.%f"),
    "%m/%d/%y %H:%M:%S,%f": lambda moment: moment.strftime("%m/%d/%y %H:%M:%S,%f"),
    "%Y%m%d-%H%M%S.%f": lambda moment: moment.strftime("%Y%m%d-%H%M%S.%f"),
    "%d %b %Y %I:%M:%S.%f %p": lambda moment: moment.strftime("%d %b %Y %I:%M:%S.%f %p"),
    "%Y %j %H:%M:%S.%f": lambda moment: moment.strftime("%Y %j %H:%M:%S.%f"),
}


@pytest.mark.parametrize("form", FORMATS)
@given(
    moments=st.lists(st.datetimes(datetime(1970, 1, 1), datetime(2068, 12, 31)), min_size=1, max_size=20)  # noqa: DTZ001
)
def test_every_format_agrees_with_the_calendar(form, moments):
    moments.sort()
    seconds, start = times_of([FORMATS[form](moment) for moment in moments], form, CET, None, "a.csv, t")
    assert start == moments[0].replace(tzinfo=CET)
    truth = [(moment - moments[0]) / timedelta(microseconds=1) * 1e-6 for moment in moments]
    np.testing.assert_allclose(seconds, truth, rtol=1e-15, atol=0.0)


def test_manners_of_loggers(subtests):
    for texts, form, zone, dates, seconds, start in [
        (["2025-03-01T06:00:00Z", "2025-03-01T06:00:01.5Z"], "iso", None, None, [0, 1.5], "2025-03-01T06:00:00+00:00"),
        (["2025-03-01 06:00:00,25+01:00"], "iso", None, None, [0], "2025-03-01T06:00:00.250000+01:00"),
        (["20250301T060000", "20250301T060002"], "iso", "Z", None, [0, 2], "2025-03-01T06:00:00+00:00"),
        (["2025-03-01 06:00", "2025-03-01 06:01"], "iso", "-05:30", None, [0, 60], "2025-03-01T06:00:00-05:30"),
        (["2025-03-01T06:00:00.000000001", "2025-03-01T06:00:00.000200003"], "iso", None, None, [0, 0.000200002], None),
        (["2024-02-28 23:59:59", "2024-02-29 00:00:01"], "iso", None, None, [0, 2], None),
        (["06:00:00.5", "06:00:00.75"], "iso", "Z", None, [0, 0.25], None),
        (["23:59:59", "00:00:01"], "iso", "Z", ["2025-03-01", "2025-03-02"], [0, 2], "2025-03-01T23:59:59+00:00"),
        (
            ["23:59:59", "00:00:01"],
            "%d.%m.%Y %H:%M:%S",
            "+01:00",
            ["01.03.2025", "02.03.2025"],
            [0, 2],
            "2025-03-01T23:59:59+01:00",
        ),
        (
            ["01.03.2025 06:00:00,123456789", "01.03.2025 06:00:00,123456790"],
            "%d.%m.%Y %H:%M:%S,%f",
            None,
            None,
            [0, 1e-9],
            None,
        ),
        (["2025-03-01 06:00:00 +0100"], "%Y-%m-%d %H:%M:%S %z", None, None, [0], "2025-03-01T06:00:00+01:00"),
    ]:
        with subtests.test(texts=texts, form=form):
            got, began = times_of(texts, form, zone and zone_of(zone, "a.csv, t"), dates, "a.csv, t")
            np.testing.assert_array_equal(got, seconds)
            assert (None if began is None else began.isoformat()) == start


def test_what_is_no_time_is_refused(subtests):
    for texts, form, zone, dates, sentence in [
        ([], "iso", None, None, "the column is blank"),
        (["2025-03-01T06:00:00", "now"], "iso", None, None, "sample 1: expected a time of ISO 8601"),
        (
            ["2025-02-30T06:00:00"],
            "iso",
            None,
            None,
            "sample 0: expected a time of the calendar; got '2025-02-30T06:00:00'",
        ),
        (["2025-03-01T25:00:00"], "iso", None, None, "sample 0: expected a time of the calendar"),
        (["2025-03-01"], "iso", None, None, "expected a time of ISO 8601"),
        (["2025-03-01T06:00:00Z"], "iso", "+01:00", None, "expected the zone stated once"),
        (["2025-03-01T06:00:00Z", "2025-03-01T06:00:00"], "iso", None, None, "sample 1: expected date and zone as in"),
        (
            ["2025-03-01T06:00:00Z", "2025-03-01T06:00:00+01:00"],
            "iso",
            None,
            None,
            "expected one zone; got Z and +01:00",
        ),
        (["2025-03-01T06:00:00"], "iso", "Europe/Berlin", None, "zone: expected an offset such as '+01:00' or 'Z'"),
        (["23:59:59", "00:00:01"], "iso", None, None, "over midnight a date is needed"),
        (["06:00"], "iso", None, ["2025-03-01", "2025-03-01"], "expected a date for each time; got 2 and 1"),
        (["01.03.2025 06:00:00"], "%m/%d/%Y %H:%M:%S", None, None, "sample 0: expected a time as '%m/%d/%Y %H:%M:%S'"),
        (["13.13.2025 06:00:00"], "%d.%m.%Y %H:%M:%S", None, None, "expected a time of the calendar"),
        (["1 Mai 2025 06:00"], "%d %b %Y %H:%M", None, None, "sample 0: expected a time as '%d %b %Y %H:%M'"),
        (["01.03.2025"], "%d.%m.%Y", None, None, "format: expected 'iso' or a pattern with hours"),
        (["0001-01-01T00:00:00"], "iso", None, None, "expected a time of the calendar"),
        (["06:00"], "%H:%M%", None, None, "sample 0: expected a time as '%H:%M%'"),
    ]:
        with subtests.test(texts=texts, form=form):
            with pytest.raises(RecordingFormatError) as caught:
                times_of(texts, form, zone and zone_of(zone, "a.csv, t"), dates, "a.csv, t")
            assert str(caught.value).startswith("a.csv, t")
            assert sentence in str(caught.value)


def test_a_zone_may_be_given_as_such():
    assert times_of(["2025-03-01T06:00:00"], "iso", CET, None, "t")[1] == datetime(2025, 3, 1, 5, tzinfo=UTC)
