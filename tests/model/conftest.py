import pytest
from oracles import CASES, Case


@pytest.fixture(params=CASES.values(), ids=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    """A walker with numbers and an oracle of its mechanics."""
    return request.param
