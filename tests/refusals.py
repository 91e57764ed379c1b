"""The one sentence in which a mistake is refused."""

from collections.abc import Callable
from typing import Any

import pytest

from gaitopt.errors import GaitoptError, ProblemError


def refusal(call: Callable[..., Any], *arguments: Any, kind: type[GaitoptError] = ProblemError, **options: Any) -> str:
    """What a call says that must raise, on one line."""
    with pytest.raises(kind) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)
