"""Couple receptances: the response of an assembly from the responses of its substructures.

Array level; any leading axes (frequency, position, draw) are carried along. Points are indices into the last two axes
of a receptance, which holds the response at the row's point to a force (or torque) at the column's point.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError


def joint_receptance(omega: FloatArray, stiffness: complex, damping: float) -> ComplexArray:
    r"""Return the receptance of a spring and a damper side by side.

    .. math::

        h_J = \frac{1}{k + j \omega c}

    Eqs. (6) and (8) of Tian et al.

    ``omega``: [rad/s], shape (n_frequencies,); ``stiffness``: k, complex if the spring has a loss factor. [N/m] or
    [N·m/rad]; ``damping``: c. [N·s/m] or [N·m·s/rad]. Returned: [m/N] or [rad/(N·m)], shape (n_frequencies,).
    ``OutsideValidityError`` if there is neither stiffness nor damping: what does not hold must be left out.

    Notes
    -----
    As printed, Eqs. (6) and (8) are the reciprocal of a receptance, see docs/reference/errata.md.
    """
    if stiffness == 0.0 and damping == 0.0:
        raise OutsideValidityError("a joint must have stiffness or damping; got 0 N/m and 0 N·s/m, leave it out")
    return np.asarray(1.0 / (stiffness + 1j * omega * damping), dtype=np.complex128)


def couple_receptances(
    receptance_a: npt.ArrayLike,
    receptance_b: npt.ArrayLike,
    points: tuple[int, int],
    *,
    joint: npt.ArrayLike = 0.0,
    keep: Sequence[int] | None = None,
) -> ComplexArray:
    r"""Couple a point of substructure A with a point of substructure B.

    .. math::

        \mathbf H = \begin{bmatrix} \mathbf H_A & 0 \\ 0 & \mathbf H_B \end{bmatrix}
        - \mathbf v \left[ h_{A,aa} + h_{B,bb} + h_J \right]^{-1} \mathbf w^T

    with v and w the columns and rows of a and, negative, b. Eqs. (4), (13), (17), (23) and (24) of Tian et al. with h_J
    = 0, rigid coupling. What holds in the joint is the force that closes the gap between both points.

    ``receptance_a``: [m/N], or any other response per unit of its own excitation, shape (..., n_a, n_a);
    ``receptance_b``: shape (..., n_b, n_b); ``points``: a of A and b of B; ``joint``: receptance h_J of the joint;
    0: rigid [m/N], shape (...); ``keep``: points of the assembly to return, those of A first (0 … n_a − 1), then
    those of B (n_a …); all if not given. Returned: , shape (..., n_keep, n_keep). ``OutsideValidityError`` if a
    receptance is not square, a point does not exist, or the leading axes do not match.

    Examples
    --------
    Two masses of 1 kg, rigidly coupled, at 1 rad/s: −1/(ω² 2 kg)

    >>> couple_receptances([[-1.0]], [[-1.0]], (0, 0), keep=[0]).item()
    (-0.5+0j)
    """
    h_a, h_b = _receptance(receptance_a, "A"), _receptance(receptance_b, "B")
    n_a, n_b = h_a.shape[-1], h_b.shape[-1]
    a, b = _point(points[0], n_a, "A"), _point(points[1], n_b, "B")
    kept = _kept(keep, n_a + n_b)
    leading = _leading_axes(h_a.shape[:-2], h_b.shape[:-2], np.shape(joint))

    side_by_side = np.zeros((*leading, n_a + n_b, n_a + n_b), dtype=np.complex128)
    side_by_side[..., :n_a, :n_a] = h_a
    side_by_side[..., n_a:, n_a:] = h_b
    moved = side_by_side[..., :, a] - side_by_side[..., :, n_a + b]  # by a unit force in the joint
    opened = side_by_side[..., a, :] - side_by_side[..., n_a + b, :]  # gap per unit excitation of each point
    gap = h_a[..., a, a] + h_b[..., b, b] + np.asarray(joint)
    return _closed(side_by_side[..., kept[:, None], kept], moved[..., kept], opened[..., kept], gap)


def ground_receptance(
    receptance: npt.ArrayLike, point: int, *, joint: npt.ArrayLike = 0.0, keep: Sequence[int] | None = None
) -> ComplexArray:
    r"""Hold a point of a substructure against the ground: coupling with a bed of no receptance, h = 0.

    .. math::

        \mathbf H = \mathbf H_A - \mathbf h_{\cdot a} \left[ h_{aa} + h_J \right]^{-1} \mathbf h_{a \cdot}

    Eqs. (5), (7) and (9) of Tian et al.

    ``receptance``: shape (..., n, n); ``point``: where it is held; ``joint``, ``keep``: as for
    :func:`couple_receptances`; so are the units, the errors and what is returned.
    """
    h = _receptance(receptance, "A")
    a, kept = _point(point, h.shape[-1], "A"), _kept(keep, h.shape[-1])
    _leading_axes(h.shape[:-2], np.shape(joint))
    gap = h[..., a, a] + np.asarray(joint)
    return _closed(h[..., kept[:, None], kept], h[..., kept, a], h[..., a, kept], gap)


def _closed(
    receptance: ComplexArray, column: ComplexArray, row: ComplexArray, gap: npt.NDArray[np.complex128]
) -> ComplexArray:
    return np.asarray(receptance - column[..., :, None] * (row / gap[..., None])[..., None, :])


def _receptance(values: npt.ArrayLike, name: str) -> ComplexArray:
    array = np.asarray(values, dtype=np.complex128)
    if array.ndim < 2 or array.shape[-1] != array.shape[-2]:
        raise OutsideValidityError(f"the receptance of {name} must be square in its last two axes; got {array.shape}")
    return array


def _point(point: int, n_points: int, name: str) -> int:
    if not 0 <= point < n_points:
        raise OutsideValidityError(f"{name} has points 0 to {n_points - 1}; got {point}")
    return point


def _kept(keep: Sequence[int] | None, n_points: int) -> npt.NDArray[np.intp]:
    kept = range(n_points) if keep is None else keep
    return np.array([_point(point, n_points, "the assembly") for point in kept], dtype=np.intp)


def _leading_axes(*shapes: tuple[int, ...]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise OutsideValidityError(
            f"substructures and joint must have matching leading axes; got {', '.join(map(str, shapes))}"
        ) from None
