"""The index of a long session says what its groups say, counts only while nothing has changed, and is never trusted."""

import contextlib
from datetime import UTC, datetime, timedelta

import h5py
import numpy as np
import pytest

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import Conditions, Direction, ExcitationQuantity, ExcitationSource, Session, Window
from monitor_core.recordings import check_file, open_session, read_session, write_session
from monitor_core.recordings.session_index import NAME, seal

START = datetime(2025, 3, 1, 6, 0, 0, 250000, tzinfo=UTC)


def window(number, **changes):
    rng = np.random.default_rng(number)
    stated = {
        "excitation": rng.standard_normal(40 + number).astype(np.float32),
        "response": rng.standard_normal(40 + number),
        "sample_rate": 2000.0,
        "started_at": START + timedelta(seconds=number),
        "conditions": Conditions(0.1 + 0.1 * number, temperature=20.5 if number else None),
        "measurement": f"Messung {number // 2} µ",
    } | changes
    return Window(**stated)


def windows():
    return (
        window(0),
        window(1, position_trace=np.linspace(0.2, 0.25, 41), position_span=0.05),
        window(2, direction=Direction.NEGATIVE, conditions=Conditions(0.3, np.float32(5.1), 21.0, np.int64(800))),
        window(3, excitation_quantity=ExcitationQuantity.FORCE, excitation_source=ExcitationSource.DRIVE),
    )


@pytest.fixture
def indexed(tmp_path, monkeypatch):
    monkeypatch.setattr("monitor_core.recordings.session_hdf5.FEWEST_WINDOWS", 4)
    path = tmp_path / "long.session.h5"
    write_session(path, Session("x", windows(), "long", START))
    return path


def reseal(path):
    with h5py.File(path) as file:
        start = file[NAME].id.get_offset()
    seal(path, start)


def rewrite(path, old, new):
    """Replace some of the text of the index by as many bytes, and make it count again."""
    assert len(old) == len(new)
    content = path.read_bytes()
    start = content.index(b'{"common"')
    assert old in content[start:]
    path.write_bytes(content[:start] + content[start:].replace(old, new, 1))
    reseal(path)


def counts(path):
    with open_session(path) as reader:
        return reader._index is not None


def assert_same(first, second):
    for name in ("excitation", "response", "position_trace"):
        left, right = getattr(first, name), getattr(second, name)
        assert (left is None) == (right is None)
        if left is not None:
            assert left.dtype == right.dtype
            np.testing.assert_array_equal(left, right)
            assert not left.flags.writeable
    for name in ("sample_rate", "started_at", "conditions", "measurement", "excitation_quantity", "excitation_source",
                 "direction", "position_span"):  # fmt: skip
        assert getattr(first, name) == getattr(second, name)


def test_an_index_says_what_the_groups_say(indexed, tmp_path):
    without = tmp_path / "without.session.h5"
    without.write_bytes(indexed.read_bytes())
    with h5py.File(without, "r+") as file:
        del file[NAME]
    assert counts(indexed)
    assert not counts(without)
    with_index, other = read_session(indexed), read_session(without)
    assert (with_index.axis_id, with_index.description, with_index.created) == (
        other.axis_id,
        other.description,
        other.created,
    )
    for left, right in zip(with_index.windows, other.windows, strict=True):
        assert_same(left, right)
    with open_session(indexed) as fast, open_session(without) as slow:
        assert fast.measurements == slow.measurements
        assert [fast.length(name) for name in fast.measurement_of] == [
            slow.length(name) for name in slow.measurement_of
        ]


def test_a_session_with_an_index_is_valid(indexed):
    assert check_file(indexed).valid


def test_the_same_session_gives_the_same_index(indexed):
    first = indexed.read_bytes()
    write_session(indexed, Session("x", windows(), "long", START))
    assert indexed.read_bytes() == first


def test_a_short_session_has_no_index(tmp_path):
    path = tmp_path / "short.session.h5"
    write_session(path, Session("x", windows()))
    assert not counts(path)


def test_a_file_changed_since_is_read_by_its_groups(indexed):
    with h5py.File(indexed, "r+") as file:
        file["windows/000002"].attrs["position_mm"] = 345.0
        file["windows/000003/response"][5] = 7.0
    assert not counts(indexed)
    found = read_session(indexed).windows
    assert found[2].conditions.position == 0.345
    assert found[3].response[5] == 7.0


@pytest.mark.parametrize("at", [0, 3, 8, 9, 60, 200, -1])
def test_a_damaged_index_is_left_alone(indexed, at):
    expected = read_session(indexed)
    content = bytearray(indexed.read_bytes())
    start = content.index(b'{"common"') - 8
    place = start + at if at >= 0 else content.index(b"}}}", start)
    content[place] ^= 1
    indexed.write_bytes(content)
    assert not counts(indexed)
    for left, right in zip(read_session(indexed).windows, expected.windows, strict=True):
        assert_same(left, right)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda file: file["windows/000002"].attrs.modify("position_mm", 345.0), "000002, position_mm"),
        (lambda file: file["windows/000001"].attrs.modify("payload_kg", 1.0), "000001, payload_kg"),
        (lambda file: file["windows/000001"].attrs.modify("started_at", "2025-03-01T06:00:02Z"), "000001, started_at"),
        (lambda file: file["windows/000003"].move("response", "position"), "000003/response"),
    ],
)
def test_an_index_that_contradicts_a_group_is_refused(indexed, change, said):
    with h5py.File(indexed, "r+") as file:
        change(file)
    reseal(indexed)
    assert counts(indexed)
    report = check_file(indexed)
    assert not report.valid
    assert said in report.problems[0]


def test_samples_elsewhere_in_the_file_are_a_contradiction(indexed):
    content = indexed.read_bytes()
    start = content.index(b'"excitation":[', content.index(b'{"common"')) + len(b'"excitation":[')
    number = content[start : content.index(b",", start)]
    rewrite(indexed, b'"excitation":[' + number, b'"excitation":[' + str(int(number) + 8).encode())
    report = check_file(indexed)
    assert not report.valid
    assert "where the index of the session says" in report.problems[0]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b',40,"<f4"]', b',10,"|O4"]'),
        (b',40,"<f4"]', b',-9,"<f4"]'),
        (b'"excitation":[', b'"ex/itation":['),
        (b'"000003":{', b'"000004":{'),
        (b'"channels":{', b'"channals":{'),
        (b'"windows":', b'"wyndows":'),
        (b'"sample_rate_hz":2000.0', b'"sample_rate_hz":-200.0'),
        (b'{"common":{', b'[[[[[[[[[[['),
    ],
)  # fmt: skip
def test_an_index_that_cannot_be_is_refused(indexed, old, new):
    rewrite(indexed, old, new)
    with pytest.raises(RecordingFormatError, match=r"^long\.session\.h5"):
        read_session(indexed)


def test_an_index_never_leads_out_of_the_file(indexed):
    content = indexed.read_bytes()
    start = content.index(b'"excitation":[', content.index(b'{"common"')) + len(b'"excitation":[')
    place = content[start : content.index(b',"<f4"', start)]
    rewrite(indexed, b'"excitation":[' + place, b'"excitation":[8,' + b"9" * (len(place) - 2))
    with pytest.raises(RecordingFormatError, match="expected a place in the file"):
        read_session(indexed)


def test_changed_bytes_of_a_sealed_index_are_refused_or_read(indexed):
    sound = indexed.read_bytes()
    start = sound.index(b'{"common"')
    end = sound.index(b"}}}", start) + 3
    rng = np.random.default_rng(2)
    with h5py.File(indexed) as file:
        place = file[NAME].id.get_offset()
    for _ in range(300):
        content = bytearray(sound)
        for at in rng.integers(start, end, rng.integers(1, 4)):
            content[at] = rng.choice([rng.integers(256), *b'"[]{},:-0e9'])
        indexed.write_bytes(content)
        seal(indexed, place)
        with contextlib.suppress(RecordingFormatError):  # anything else is a fault
            read_session(indexed)
