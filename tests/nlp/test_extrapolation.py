"""Extrapolation is exact for the polynomials that it fits, and declines where it would only amplify rounding."""

import numpy as np
import pytest

from gaitopt.nlp.newton import extrapolation

pytestmark = pytest.mark.portable


@pytest.mark.parametrize("slopes", [False, True])
@pytest.mark.parametrize("places", [[0.0], [0.0, -0.1], [0.0, -1e-5, -3e-5], [0.0, -2.0, 1.5]])
def test_polynomials_are_continued_exactly(places: list[float], slopes: bool) -> None:
    degree = len(places) * (1 + slopes) - 1
    unit = np.abs(places).max() or 1e-3
    coefficients = np.random.default_rng(3).standard_normal(degree + 1)
    curve = np.polynomial.Polynomial(coefficients, window=[-1, 1], domain=[-unit, unit])
    ahead = 0.3 * unit if len(places) > 1 else unit
    weights = extrapolation(places, ahead, slopes=slopes)
    assert weights is not None
    known = [*curve(np.array(places)), *(curve.deriv()(np.array(places)) if slopes else [])]
    assert weights @ known == pytest.approx(curve(ahead), rel=1e-9)


def test_too_far_ahead_there_is_no_extrapolation() -> None:
    assert extrapolation([0.0, -1e-3, -2e-3], 1.0) is None
    assert extrapolation([0.0, 0.0], 1.0) is None
