"""Arrange the readings of a calibration in columns; refuse those that cannot determine Eq. (8)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.preload.calibration import ModalReading, Weighting

#: Positions closer than this are one position: a table does not stop better than that, and Eq. (8) does not care [m].
POSITION_RESOLUTION = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class ReadingColumns:
    """The readings as columns, each of shape (n_windows,)."""

    frequency: FloatArray  # [Hz]
    standard_uncertainty: FloatArray  # 0 where not stated [Hz]
    position: FloatArray  # [m]
    preload: FloatArray  # [N]
    payload: FloatArray  # [kg]
    temperature: FloatArray | None  # [°C]

    @property
    def payload_excess(self) -> FloatArray:
        """Above the lowest payload, the reference [kg]."""
        return self.payload - float(self.payload.min())

    @property
    def temperature_excess(self) -> FloatArray:
        """Above the mean temperature, the reference; 0 where not stated [K]."""
        if self.temperature is None:
            return np.zeros_like(self.payload)
        return self.temperature - float(self.temperature.mean())

    @property
    def inverse_square(self) -> FloatArray:
        """1/f² [s²]."""
        return 1.0 / self.frequency**2

    @property
    def slope(self) -> FloatArray:
        """|d(1/f²)/df| = 2/f³ [s³]."""
        return 2.0 / self.frequency**3


def reading_columns(readings: Sequence[ModalReading], weighting: Weighting) -> ReadingColumns:
    """Lay the readings out as columns; refuse a quantity that only some of them state."""

    def stated(name: str, values: list[float | None]) -> FloatArray | None:
        if all(v is None for v in values):
            return None
        if any(v is None for v in values):
            raise OutsideValidityError(
                f"{name} must be stated for all readings or for none; missing in {values.count(None)} of {len(values)}"
            )
        return np.array(values, dtype=np.float64)

    preload = stated("preload", [r.conditions.preload for r in readings])
    if preload is None:
        raise OutsideValidityError(f"a calibration needs the preload of every reading; got none of {len(readings)}")
    uncertainty = [r.standard_uncertainty for r in readings]
    if weighting is Weighting.STD and not all(uncertainty):
        raise OutsideValidityError(
            "weighting by scatter needs a positive frequency_std for every reading; "
            f"missing or zero in {sum(not u for u in uncertainty)} of {len(readings)}"
        )
    payload = stated("payload_mass", [r.conditions.payload_mass for r in readings])
    return ReadingColumns(
        frequency=np.array([r.frequency for r in readings]),
        standard_uncertainty=np.array([u or 0.0 for u in uncertainty]),
        position=np.array([r.conditions.position for r in readings]),
        preload=preload,
        payload=np.zeros(len(readings)) if payload is None else payload,
        temperature=stated("temperature", [r.conditions.temperature for r in readings]),
    )


def position_groups(position: FloatArray) -> list[FloatArray]:
    """Return the row numbers of the readings at each distinct position."""
    order = np.argsort(position, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(position[order]) > POSITION_RESOLUTION) + 1)


def refuse_too_few_settings(position: FloatArray, preload: FloatArray) -> None:
    """Raise NotIdentifiableError, naming what is missing, where Eq. (8) has more unknowns than settings."""
    positions, preloads = len(position_groups(position)), np.unique(preload).size
    missing = []
    if positions < 3:
        missing.append(f"three positions (at least 1 mm apart) for k1, k2, k4, got {positions}")
    if preloads < 2:
        missing.append(f"two preloads for k3, got {preloads}")
    if missing:
        raise NotIdentifiableError(f"a calibration needs, at one payload, at least {' and '.join(missing)}")
