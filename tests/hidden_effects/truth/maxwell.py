"""A spring that loses the same share of energy over a wide band: a chain of Maxwell elements."""

from dataclasses import dataclass

import numpy as np
import scipy.optimize

#: Where the loss is flat, and where the stiffness is the stated one. [Hz]
_BAND = (7.0, 3000.0)
_REFERENCE = 100.0
_RELAXATION = np.geomspace(1.4, 15e3, 8)  # [Hz]


@dataclass(frozen=True, slots=True, eq=False)
class MaxwellChain:
    """Stiffness over the stated one: constant + Σ share jωτ/(1 + jωτ)."""

    constant: float
    share: np.ndarray  # shape (n_elements,)
    time: np.ndarray  # τ, shape (n_elements,) [s]

    def stiffness(self, frequency: np.ndarray) -> np.ndarray:
        """Return the complex stiffness over the stated one."""
        lag = 2j * np.pi * np.asarray(frequency)[..., None] * self.time
        return self.constant + (lag / (1.0 + lag)) @ self.share


def maxwell_chain(loss_factor: float) -> MaxwellChain:
    """Return the chain whose loss factor over the band is nearest to the wanted one; no element for none."""
    if not loss_factor:
        return MaxwellChain(1.0, np.zeros(0), np.zeros(0))
    time = 1.0 / (2.0 * np.pi * _RELAXATION)
    lag = 2j * np.pi * np.geomspace(*_BAND, 60)[:, None] * time
    element = lag / (1.0 + lag)
    at_reference = 2j * np.pi * _REFERENCE * time
    at_reference = (at_reference / (1.0 + at_reference)).real
    # constant = 1 − Σ share Re element(reference), so that Im = η Re is linear in the shares
    wanted = element.imag - loss_factor * (element.real - at_reference)
    share, _ = scipy.optimize.nnls(wanted, np.full(len(lag), loss_factor))
    return MaxwellChain(float(1.0 - share @ at_reference), share, time)
