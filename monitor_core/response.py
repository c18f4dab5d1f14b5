"""Records of frequency responses and modes; measured and modelled ones are of one type."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray, Shown, read_only, read_only_complex
from monitor_core.errors import OutsideValidityError
from monitor_core.uncertainty import Estimate

if TYPE_CHECKING:
    from monitor_core.shown import Panel


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse(Shown):
    """A response quantity per unit excitation over frequency.

    ``quantity`` says which (ISO 7626): ``accelerance`` [m/(N·s²)] or ``torque_accelerance`` [m/(N·m·s²)], the latter
    because a torque becomes an axial force only behind the screw lead.
    """

    frequency: FloatArray  # shape (n_frequencies,) [Hz]
    response: ComplexArray  # shape (n_frequencies,)
    quantity: str
    coherence: FloatArray | None = None  # ordinary coherence γ², shape (n_frequencies,); None for a modelled response
    n_averages: float = 1.0  # effective number of independent averages

    def __post_init__(self) -> None:
        object.__setattr__(self, "frequency", read_only(self.frequency))
        object.__setattr__(self, "response", read_only_complex(self.response))
        if self.frequency.shape != self.response.shape or self.frequency.ndim != 1:
            raise OutsideValidityError(
                f"frequency and response must be of one length; got {self.frequency.shape} and {self.response.shape}"
            )
        if self.coherence is not None:
            object.__setattr__(self, "coherence", read_only(self.coherence))
            if self.coherence.shape != self.frequency.shape:
                raise OutsideValidityError(
                    f"coherence must have the shape of frequency {self.frequency.shape}; got {self.coherence.shape}"
                )

    def __repr__(self) -> str:
        """Return it in a line: the quantity, its lines and band, and how much stands behind them."""
        band = f"{self.frequency[0]:g} to {self.frequency[-1]:g} Hz" if self.frequency.size else "no line"
        return (
            f"FrequencyResponse of {self.quantity}: {self.frequency.size} lines, {band}, {self.n_averages:g} averages"
        )

    def _panels(self) -> "Sequence[Panel]":
        from monitor_core.shown import Panel  # noqa: PLC0415  # few ask

        x, x_name, name = self.frequency, "frequency [Hz]", self.quantity.replace("_", " ")
        panels = [
            Panel(name, x_name, "amplitude [SI]", x, np.abs(self.response), logarithmic=True),
            Panel("phase", x_name, "phase [°]", x, np.degrees(np.angle(self.response))),
        ]
        coherence = self.coherence
        return panels if coherence is None else [*panels, Panel("coherence", x_name, "γ² [-]", x, coherence)]

    def _columns(self) -> Mapping[str, FloatArray]:
        columns = {"frequency_hz": self.frequency, "real": self.response.real, "imaginary": self.response.imag}
        return columns if self.coherence is None else columns | {"coherence": self.coherence}


@dataclass(frozen=True, slots=True, eq=False)
class LineSpread:
    """What an estimate shows of a response: the sum over steps of ``weights`` times it at a line plus ``offsets``."""

    offsets: FloatArray  # from a line, the first one 0, shape (n_steps,) [Hz]
    weights: ComplexArray  # shape (n_steps, n_lines) [-]

    def __post_init__(self) -> None:
        object.__setattr__(self, "offsets", read_only(self.offsets))
        object.__setattr__(self, "weights", read_only_complex(self.weights))
        fits = self.weights.ndim == 2 and self.offsets.shape == self.weights.shape[:1]
        if not fits or not self.offsets.size or self.offsets[0] != 0.0:
            raise OutsideValidityError(
                f"a spread must have a row of weights for each offset, that of the line itself first; got shapes "
                f"{self.offsets.shape} and {self.weights.shape}"
            )

    def of_lines(self, chosen: BoolArray) -> "LineSpread":
        """Return the spread of the lines for which ``chosen`` is true, shape (n_lines,)."""
        return LineSpread(self.offsets, self.weights[:, chosen])


@dataclass(frozen=True, slots=True, eq=False)
class ModalParameters:
    """One mode: natural frequency and damping ratio with their joint covariance, and the residue's phase.

    ``residue`` is −B(f_n) of the fitted B(f)/(f_n² − f² + 2jζ f_n f): positive real for an accelerance of a passive
    axis with both channels in their natural polarity and no delay between them.
    """

    frequency: Estimate  # natural frequency f_n [Hz]
    damping_ratio: Estimate  # ζ [-]
    frequency_damping_covariance: float  # [Hz]
    residue: complex

    @property
    def residue_phase(self) -> float:
        """Phase of the residue in radians; 0 for an accelerance in natural polarity without delay."""
        return float(np.angle(self.residue))
