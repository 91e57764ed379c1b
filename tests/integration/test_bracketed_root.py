"""The root of an event between two times at which its margin has opposite signs."""

import numpy as np
import pytest

from gaitopt.integration import bracketed_root


@pytest.mark.portable
@pytest.mark.parametrize(
    ("function", "low", "high", "root"),
    [
        (lambda x: x**3 - 2, 0.0, 2.0, 2 ** (1 / 3)),
        (lambda x: 1 - x, 0.0, 3.0, 1.0),
        (lambda x: np.tanh(1e3 * (x - 0.7)), 0.0, 1.0, 0.7),
        (lambda x: (x - 0.3) ** 9, 0.0, 1.0, 0.3),
        (lambda x: np.sign(x - 0.4), 0.0, 1.0, 0.4),
        (lambda x: x, 0.0, 1.0, 0.0),
    ],
)
def test_bracketed_root_is_where_the_function_changes_sign(function, low, high, root):
    calls = []

    def counted(x):
        calls.append(x)
        return float(function(x))

    assert bracketed_root(counted, low, high, 1e-12) == pytest.approx(root, abs=1e-12)
    assert len(calls) < 120
    assert all(low <= x <= high for x in calls)
    with pytest.raises(ValueError, match="no change of sign"):
        bracketed_root(lambda x: x * x + 1, -1.0, 1.0, 1e-12)
