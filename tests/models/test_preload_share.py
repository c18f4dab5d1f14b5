"""The share of 1/f² that is the preload's, by a drive model."""

from pathlib import Path

import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models.preload_share import share_of_preload
from monitor_core.recordings.model_file import read_model_file

MODELS = Path(__file__).resolve().parents[2] / "replay_data" / "models"


def test_share_of_the_lumped_axis_is_that_of_its_own_coefficients() -> None:
    """Table 3 of Nguyen et al. (2018): k3/∛P of 1/f² at 100 and 300 N is .14 and .10 at 500 mm."""
    share = share_of_preload(read_model_file(MODELS / "lumped.toml").build())
    for preload in (100.0, 300.0):
        of_feature = 2097e-8 * preload ** (-1.0 / 3.0)
        rest = -4872e-8 * 0.5**2 + 5561e-8 * 0.5 + 1228e-8
        assert share.lower < of_feature / (of_feature + rest) < share.upper


def test_share_of_the_simulated_machine_covers_that_of_its_calibration() -> None:
    """The plant of ``tests/plant`` at 300 N and 500 mm, as its 39 bundled measurements show it."""
    share = share_of_preload(read_model_file(MODELS / "replay-axis.toml").build())
    assert share.lower < 2.13e-6 / 2.85e-5 < share.upper
    assert share.upper < 0.25  # far less than what is taken without a model


def test_a_nut_of_one_rigidity_tells_no_share() -> None:
    with pytest.raises(OutsideValidityError, match="dynamic_load_rating"):
        share_of_preload(read_model_file(MODELS / "hybrid.toml").build())
