r"""Forces that follow from the motion they make, step by step in time.

.. math::

    m_n = a_n + \sum_{k \le n} q_{n-k} f_k, \qquad f_n = \mathrm{law}(m_n, m_{n-1})

with the motion :math:`a` that there would be without the forces, and the response :math:`q` to a force of 1 held over
one step. Forces act upon later blocks through transforms that double in length [1]_, upon their own block one by one.
That part is the same source as Python or, where numba is installed (extra ``compiled``), as machine code.

References
----------
.. [1] E. Hairer, C. Lubich, M. Schlichte, Fast numerical solution of nonlinear Volterra convolution equations, SIAM
   J. Sci. Stat. Comput. 6, 1985.
"""

import functools
import importlib.util
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

BLOCK = 64  # steps whose forces act upon each other one by one
ROUNDS = 50  # at most, until force and motion agree
AGREEMENT = 1e-10  # of a motion with the one before, relative


class Laws(NamedTuple):
    r"""Force against motion at each place; arrays of shape (n_laws, n_settings).

    Coulomb friction where it is not zero: the motion is the velocity at the end of each step. Otherwise the force is
    :math:`k (\beta m^2 - p m^2 / (m^2 + d^2)) m` and the motion a deflection, its mean over each step.
    """

    friction: FloatArray  # [N]
    stiffness: FloatArray  # k [N/m]
    cubic: FloatArray  # β [1/m²]
    softening: FloatArray  # p [-]
    scale: FloatArray  # d [m]


def solve_volterra(laws: Laws, free: FloatArray, responses: FloatArray) -> FloatArray:
    """Return the force of each law in each step.

    Parameters
    ----------
    laws : Laws
    free : ndarray, shape (n_laws, n_settings, n_steps)
        Motion without the forces.
    responses : ndarray, shape (n_laws, n_laws, n_settings, n_memory)
        Motion at the first law's place after a force of 1 of the second's, held over the first step. ``n_memory`` is
        ``BLOCK`` times a power of two; a force is forgotten after as many steps or somewhat later.

    Returns
    -------
    ndarray, shape (n_laws, n_settings, n_steps)
    """
    motion, force = free.copy(), np.zeros_like(free)
    n_steps, n_memory = free.shape[-1], responses.shape[-1]
    near = np.ascontiguousarray(responses[..., :BLOCK])
    spectra: dict[int, NDArray[np.complex128]] = {}
    solve = block_solver()
    for start in range(0, n_steps, BLOCK):
        if start:
            # the largest power of two in the number of steps so far: every two blocks meet once, when the later begins
            span = min(start & -start, n_memory)
            if span not in spectra:
                spectra[span] = scipy.fft.rfft(responses[..., : 2 * span], 2 * span)
            acting = scipy.fft.rfft(force[..., start - span : start], 2 * span)
            after = scipy.fft.irfft(np.einsum("absf,bsf->asf", spectra[span], acting), 2 * span)
            following = motion[..., start : start + span]
            following += after[..., span : span + following.shape[-1]]
        solve(laws, motion, force, near, (start, min(start + BLOCK, n_steps)))
    return force


@functools.cache  # compiling takes a second or two
def block_solver() -> Callable[..., None]:
    """Return the solver of a block, as machine code if there is a compiler for it."""
    if importlib.util.find_spec("numba") is None:
        return _build(lambda function: function)
    import numba

    return _build(numba.njit)


def _build(compiled: Callable[[Callable[..., Any]], Callable[..., Any]]) -> Callable[..., None]:
    """Put the solver of a block together from functions that are compiled, or left as they are."""
    # numba finds what it has compiled among the names of this function
    friction_force, nut_force = compiled(_friction_force), compiled(_nut_force)

    def solve(laws: Laws, motion: FloatArray, force: FloatArray, near: FloatArray, block: tuple[int, int]) -> None:
        """Fill in the forces of a block and the motion they make."""
        n_laws, n_settings, _ = motion.shape
        start, end = block
        for s in range(n_settings):
            for step in range(start, end):
                force[:, s, step] = force[:, s, step - 1]  # where to begin; before the first step a zero at the end
                for _ in range(ROUNDS):
                    agreed = True
                    for a in range(n_laws):
                        own, last = near[a, a, s, 0], motion[a, s, step - 1] if step else 0.0
                        now = motion[a, s, step] + np.sum(near[a, :, s, 0] * force[:, s, step])
                        alone = now - own * force[a, s, step]
                        if laws.friction[a, s] > 0.0:
                            force[a, s, step] = friction_force(laws.friction[a, s], alone, own, last)
                        else:
                            force[a, s, step] = nut_force(laws, (a, s), alone, own, now)
                        agreed = agreed and abs(alone + own * force[a, s, step] - now) <= AGREEMENT * abs(alone)
                    if agreed:
                        break
                for a in range(n_laws):
                    for b in range(n_laws):
                        motion[a, s, step:end] += near[a, b, s, : end - step] * force[b, s, step]

    return compiled(solve)


def _friction_force(level: float, alone: float, own: float, last: float) -> float:
    """Return the mean force over a step in which everything else pushes steadily, from the velocity ``last`` on.

    Without it the velocity would end at ``alone``. What moves goes on against it, or stops and stays, or stops and
    turns; then the force turns with it in the middle of the step.
    """
    forward = 1.0 if last >= 0.0 else -1.0
    speed, end = forward * last, forward * alone
    if end > own * level:
        return -forward * level
    if speed - end <= own * level:
        return -alone / own
    return forward * level * (1.0 - 2.0 * speed / (speed - end + own * level))


def _nut_force(laws: Laws, place: tuple[int, int], alone: float, own: float, motion: float) -> float:
    """Return the force f for a motion of alone + own · f by one step of Newton's method from ``motion``."""
    square, scale = motion**2, laws.scale[place] ** 2
    kept = scale / (square + scale)
    lost = laws.softening[place] * (1.0 - kept)
    here = laws.stiffness[place] * (laws.cubic[place] * square - lost) * motion
    slope = laws.stiffness[place] * (3.0 * laws.cubic[place] * square - lost * (1.0 + 2.0 * kept))
    return (here + slope * (alone - motion)) / (1.0 - own * slope)
