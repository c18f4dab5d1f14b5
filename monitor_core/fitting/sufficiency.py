"""What the problems of any drive model share: when there is nothing to be found.

``model_modal_problem`` takes natural frequencies, ``model_response_problem`` whole frequency responses. Both build a
model once per set of coordinates.
"""

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.coordinates import ModelCoordinates

#: A parameter whose slopes are below this share of the largest plays no part: so much is rounding of the derivatives.
#: One that plays too small a part is for :func:`~monitor_core.identification.identifiability.assess` to name. [-]
_FLAT = 1e-8


def require_enough(drive: ModelCoordinates, n_data: int, what: str) -> None:
    """Refuse fewer data than free parameters; a prior stands for a datum.

    Parameters
    ----------
    drive : ModelCoordinates
    n_data : int
    what : str
        What the data are called in the sentence.

    Raises
    ------
    NotIdentifiableError
        If there is no datum, or too few.
    """
    needed = len(drive.free) - len(drive.uncertain)
    if not n_data or n_data < needed:
        raise NotIdentifiableError(
            f"{len(drive.free)} free parameters, {len(drive.uncertain)} of them with a prior, need {max(needed, 1)} "
            f"{what} at least; got {n_data}; measure at more positions or free fewer"
        )


def require_seen(drive: ModelCoordinates, jacobian: FloatArray) -> None:
    """Refuse a free parameter without a prior that no datum moves with.

    Parameters
    ----------
    drive : ModelCoordinates
    jacobian : ndarray, shape (n_residuals, n_parameters)
        At the model as stated.

    Raises
    ------
    NotIdentifiableError
        If there is one.
    """
    for name in unseen(drive, jacobian):
        if name not in drive.uncertain:
            raise NotIdentifiableError(
                f"{name} moves no datum and has no prior uncertainty; measure what depends on it, or do not free it"
            )


def unseen(drive: ModelCoordinates, jacobian: FloatArray) -> tuple[str, ...]:
    """Return the free parameters that no datum moves with.

    Parameters
    ----------
    drive : ModelCoordinates
    jacobian : ndarray, shape (n_residuals, n_parameters)
        At the model as stated.
    """
    slopes: FloatArray = np.linalg.norm(jacobian, axis=0)
    return tuple(name for name, slope in zip(drive.free, slopes, strict=True) if slope <= _FLAT * slopes.max())
