"""Linear and Quadratic: polynomials through the first ten true states (paper, section 5.1)."""

import numpy as np
from jaxtyping import Float

POINTS = 10
"""States that they are given, t = -3..6: six more than any network sees."""


def polynomial(
    history: Float[np.ndarray, "sequences objects ten values"], degree: int, horizon: int
) -> Float[np.ndarray, "sequences objects steps values"]:
    """Least-squares polynomial through the states of t = -3..6, at the steps t = 0..T-1."""
    given = np.arange(history.shape[2]) - 3.0
    powers = np.arange(degree + 1)
    coefficients = np.einsum("ct,nktd->nkcd", np.linalg.pinv(given[:, None] ** powers), history)
    asked = np.arange(horizon)[:, None] ** powers
    return np.einsum("tc,nkcd->nktd", asked, coefficients)
