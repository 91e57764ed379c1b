"""One loop for all Newton and chord methods: when it is solved, and when it is given up."""

import numpy as np
import pytest

from gaitopt.iteration import bracketed_root, iterate


def residual(x: float) -> float:
    return abs(x * x - 2)


def newton(x: float) -> float:
    return x - (x * x - 2) / (2 * x)


def solved(x: float) -> bool:
    return residual(x) < 1e-14


def chord(x: float) -> float:
    return x - (x * x - 2) / 3


def test_newton_doubles_the_digits_and_a_chord_takes_longer() -> None:
    ends = [iterate(1.5, step, size=residual, solved=solved, most=40) for step in (newton, chord)]
    assert all(end.solved and end.at == pytest.approx(2**0.5, rel=1e-14) for end in ends)
    assert ends[0].count <= 4 < ends[1].count


def test_a_step_that_does_not_contract_is_not_kept() -> None:
    end = iterate(1.5, lambda x: 2 * x, size=residual, solved=solved, most=40)
    assert (end.at, end.solved, end.count) == (1.5, False, 1)
    assert not iterate(1.5, chord, size=residual, solved=solved, most=40, contraction=1e-3).solved
    nowhere = iterate(1.5, lambda x: float("nan"), size=residual, solved=lambda x: False, most=9)
    assert (nowhere.at, nowhere.count) == (1.5, 1)


def test_a_method_may_decide_by_itself_what_it_allows() -> None:
    rising = iterate(0.1, newton, size=residual, solved=solved, most=40, contraction=np.inf)
    assert rising.solved  # though the first step leads to x = 10


def test_no_more_are_tried_than_allowed_and_the_last_one_counts() -> None:
    assert iterate(1.5, chord, size=residual, solved=solved, most=3).count == 3
    assert iterate(1.5, newton, size=residual, solved=solved, most=4).solved


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


def test_bracketed_root_refuses_an_interval_without_a_change_of_sign():
    with pytest.raises(ValueError, match="no change of sign"):
        bracketed_root(lambda x: x * x + 1, -1.0, 1.0, 1e-12)
