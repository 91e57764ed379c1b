"""Repetitions of one claim: a sample of them is quick, and ``-m slow`` runs them all."""

from collections.abc import Iterable
from typing import Any

import pytest


def sampled(cases: Iterable[Any], every: int = 5) -> list[Any]:
    """Cases for ``parametrize``, of which all but every n-th are marked slow.

    In a grid ``every`` has no common factor with the length of a row: then the sample meets each row and each column.
    """
    return [
        case
        if k % every == 0
        else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
        for k, case in enumerate(cases)
    ]
