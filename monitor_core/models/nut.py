"""Compute the rigidity of a preloaded nut."""

from monitor_core.errors import OutsideValidityError


def nut_rigidity(nut_stiffness: float, preload: float | None, dynamic_load_rating: float | None) -> float:
    r"""Return the axial rigidity of the nut in newtons per metre.

    .. math::

        k_{nut} = 0.8 K \left( \frac{P}{0.1\,C_d} \right)^{1/3}

    Eq. (1) of Nguyen et al. (2018), after the catalogues (ISO 3408-4). Where neither preload nor load rating is stated
    the nut has the stated stiffness whatever its preload, as in the other three papers.

    ``nut_stiffness`` is :math:`K` of the catalogue, or the rigidity itself [N/m]; preload and load rating are
    :math:`P` and :math:`C_d` [N]. ``OutsideValidityError`` if only one of the two is stated, or the preload exceeds
    the 10 % of the load rating up to which the source states the equation.
    """
    if preload is None and dynamic_load_rating is None:
        return nut_stiffness
    if preload is None:
        raise OutsideValidityError(
            "the nut rigidity of this model follows the preload (dynamic_load_rating_n is stated); state the preload"
        )
    if dynamic_load_rating is None:
        raise OutsideValidityError(
            f"a preload of {preload} N has no effect in a model without dynamic_load_rating_n; state the rating"
        )
    rated_preload = 0.1 * dynamic_load_rating
    if preload > rated_preload * (1.0 + 1e-9):
        raise OutsideValidityError(
            f"preload must not exceed 10 % of the dynamic load rating, {rated_preload:g} N; got {preload:g} N"
        )
    return float(0.8 * nut_stiffness * (preload / rated_preload) ** (1.0 / 3.0))
