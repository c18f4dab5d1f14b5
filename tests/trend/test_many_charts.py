"""The charts of many axes at once raise the alarms of the product's, to the day."""

import pytest

from benchmarks.false_alarms import alarms_of, alarms_of_many
from tests.conftest import canary


@pytest.mark.parametrize(
    ("row", "years", "n_axes"),
    canary(
        [("fresh grease, torque measured", 1, 2), ("shop", 2, 6), ("shop as above, stated", 1, 6),
         ("fresh grease, logged", 2, 6), ("shop, 5 a day", 1, 6), ("hourly 0.95, 24 a day", 1, 2)]
    ),
)  # fmt: skip
def test_many_axes_at_once_are_alarmed_as_each_alone(row, years, n_axes):
    together = alarms_of_many(row, 31, years, list(range(n_axes)))
    assert sum(alarms for axis in together for alarms, _ in axis) > 0
    assert together == [alarms_of(row, 31, axis, years) for axis in range(n_axes)]
