"""Tell which share of 1/f² of the axial mode depends on the preload, by the catalogue stiffnesses of a drive."""

import math
from enum import StrEnum

import numpy as np

from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, DriveModel, MotorEnd
from monitor_core.uncertainty import Estimate, Interval, IntervalKind


class PreloadLevel(StrEnum):
    """What a preload is called, by its share of the dynamic load rating (Nguyen et al., 2018, section 3.1)."""

    SLIGHT = "slight"
    NORMAL = "normal"
    TIGHT = "tight"

    @property
    def share(self) -> float:
        """Of the dynamic load rating [-]."""
        return {PreloadLevel.SLIGHT: 0.025, PreloadLevel.NORMAL: 0.05, PreloadLevel.TIGHT: 0.075}[self]


#: Preload over the load rating above which makers and Eq. (1) of Nguyen et al. (2018) do not go [-].
HIGHEST_SHARE = 0.1
#: Standard uncertainty, relative, of a catalogue stiffness as mounted (type B): of the nut, and of all the rest.
_CATALOGUE = 0.15
#: The preload is made so much smaller to see what follows it.
_LESS = 0.9
#: Where the table is asked for, in lengths of the screw.
_PLACES = (0.25, 0.5, 0.75)


def usual_log_preload(dynamic_load_rating: float) -> Estimate:
    """Return ln(P/N) of a nut that nobody measured: slightly to tightly preloaded, each as likely [-]."""
    low, high = (math.log(level.share * dynamic_load_rating) for level in (PreloadLevel.SLIGHT, PreloadLevel.TIGHT))
    return Estimate(0.5 * (low + high), (high - low) / math.sqrt(12.0))


def share_of_preload(model: DriveModel, preload: float | None = None) -> Interval:
    r"""Return the 95 % interval of the share of 1/f² that is the preload's, over the travel.

    .. math:: s = \frac{f^2(P) / f^2(P') - 1}{\sqrt[3]{P/P'} - 1}

    by Eq. (8) of Nguyen et al. (2018), in which a share s of :math:`1/f^2` goes with :math:`P^{-1/3}`. Its odds
    s/(1 − s) are a ratio of two compliances, nut to rest, each known as a catalogue has it.

    Parameters
    ----------
    model : DriveModel
        A drive whose nut follows its preload (``dynamic_load_rating``).
    preload : float, optional
        As it was put into service [N]; without it slightly to tightly preloaded.

    Returns
    -------
    Interval
        Of s. [-]

    Raises
    ------
    OutsideValidityError
        If the nut of the drive has one rigidity, or the model gives no mode.
    """
    rating = getattr(model.parameters, "dynamic_load_rating", None)
    if rating is None:
        raise OutsideValidityError(
            "the nut must follow its preload: expected dynamic_load_rating of the drive; got none"
        )
    unknown = (PreloadLevel.SLIGHT.share * rating, PreloadLevel.TIGHT.share * rating)
    preloads = unknown if preload is None else (preload,)
    length = float(getattr(model.parameters, "screw_length"))  # noqa: B009 - each family has its own record
    shares = np.array([_share(model, place * length, each) for place in _PLACES for each in preloads])
    odds = np.log(shares / (1.0 - shares))
    reach = 1.96 * math.sqrt(2.0) * _CATALOGUE
    lower, upper = (float(1.0 / (1.0 + np.exp(-end))) for end in (odds.min() - reach, odds.max() + reach))
    return Interval(lower, upper, IntervalKind.COVERAGE)


def preload_level(share: float) -> PreloadLevel | None:
    """Return what a preload is called, by its share of the dynamic load rating; None above a tenth, or next to none.

    Examples
    --------
    >>> preload_level(0.05)
    <PreloadLevel.NORMAL: 'normal'>
    """
    if not 0.5 * PreloadLevel.SLIGHT.share <= share <= HIGHEST_SHARE * (1.0 + 1e-9):
        return None
    return min(PreloadLevel, key=lambda level: abs(level.share - share))


def _share(model: DriveModel, position: float, preload: float) -> float:
    as_set, less = (
        min(mode.frequency for mode in model.natural_frequencies(at, MotorEnd.PRESCRIBED) if mode.frequency > 0.0)
        ** -2.0
        for at in (DriveConditions(position, preload), DriveConditions(position, _LESS * preload))
    )
    share = float((less / as_set - 1.0) / (_LESS ** (-1.0 / 3.0) - 1.0))
    if not 0.0 < share < 1.0:
        raise OutsideValidityError(f"the mode must follow the preload in part; got a share of {share:g} of 1/f²")
    return share
