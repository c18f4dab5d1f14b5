"""Each code that a page may show has its advice, and a plant adds its own rows."""

from pathlib import Path

import pytest

from monitor_core.change.changes import Cause
from monitor_core.recording import DoubtReason, RejectionReason
from monitor_core.trend.state import TrendStatus
from service.errors import DataFolderError
from service.operations.advice import TABLE, read_advice
from service.operations.monitoring.intake.charts import Uncharted
from service.store import alarms
from tests.service.conftest import running_service

HEALTHY = {TrendStatus.NORMAL}
CODES = {
    "cause": {*map(str, Cause), "not-examined", alarms.LOST_MOTION},
    "state": {str(state) for state in TrendStatus if state not in HEALTHY},
    "refusal": set(map(str, RejectionReason)),
    "doubt": set(map(str, DoubtReason)),
    "uncharted": set(map(str, Uncharted)),
}
OWN = """
[cause.preload]
look = [{ cause = "coolant in the nut", effect = "rust", check = "the seal", tool = "lamp", minutes = 3 }]
[refusal.clipped]
says = "Take range 2 of the amplifier in cabinet 4."
"""


def test_the_table_has_each_code_and_no_other():
    known = {(section, code) for section, codes in CODES.items() for code in codes}
    table = read_advice(None).entries
    assert set(table) == known
    assert all(advice.look and advice.n_own == 0 for advice in table.values())


def test_a_file_of_the_plant_goes_first(tmp_path: Path):
    (tmp_path / "own.toml").write_text(OWN)
    table, plain = read_advice(tmp_path / "own.toml"), read_advice(None)
    mine, theirs = table.of("cause", "preload"), plain.of("cause", "preload")
    assert mine is not None
    assert theirs is not None
    assert (mine.n_own, mine.look[0].cause, mine.look[1:]) == (1, "coolant in the nut", theirs.look)
    assert mine.says == theirs.says
    clipped = table.of("refusal", "clipped")
    assert clipped is not None
    assert clipped.says == "Take range 2 of the amplifier in cabinet 4."


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[cause.rust]\nlook = []", "expected a cause of preload, .*; got rust"),
        ("[causes.preload]\nlook = []", "causes: Input should be 'cause'"),
        ("[cause.preload]\nlook = [{ cause = 'x' }]", "cause.preload.look.0.effect: Field required"),
        ("[cause.preload", "cannot be read"),
    ],
)
def test_what_the_file_says_wrongly_is_told_in_a_sentence(tmp_path: Path, text: str, sentence: str):
    (tmp_path / "own.toml").write_text(text)
    with pytest.raises(DataFolderError, match=sentence):
        read_advice(tmp_path / "own.toml")


def test_the_service_answers_the_table_with_the_rows_of_the_plant(tmp_path: Path):
    (tmp_path / "own.toml").write_text(OWN)
    with running_service(tmp_path / "data", advice_file=tmp_path / "own.toml") as api:
        answer = api.http.get("/v1/advice").json()["advice"]
    first = next(advice for advice in answer if (advice["section"], advice["code"]) == ("cause", "preload"))
    assert first["own"] == 1
    assert first["look"][0]["check"] == "the seal"
    assert len(answer) == len(read_advice(None).entries)
    assert TABLE.is_file()
