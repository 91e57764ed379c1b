"""A problem as texts: it is read again as the same problem, from nothing but these texts."""

import pytest
from samples import sampled

import gaitopt as go
from gaitopt.errors import ProblemError
from gaitopt.model.units import parse_angle
from gaitopt.problem.source import problem_names
from gaitopt.problem.statement import problem_data
from gaitopt.problem.writing import ExactValues, ProblemText, read_problem, write_problem


def same(one: go.Problem, other: go.Problem) -> bool:
    """Whether two problems are equal but for guesses and descriptions."""
    data = [problem_data(problem) for problem in (one, other)]
    for each in data:
        each.pop("about")
        each["gait"].pop("guess", None)
    return data[0] == data[1] and (one.reference is None or same(one.reference, other.reference))


@pytest.mark.parametrize("name", sampled(problem_names(), 3))
def test_a_named_problem_is_its_file(name: str) -> None:
    problem = go.load_problem(name)
    source = write_problem(problem)
    assert source.text == problem.text
    assert not source.changes
    assert same(read_problem(source), problem)
    exact = ExactValues(source)
    for key, value in problem.parameters.items():
        text = exact(key, float(value))
        assert (parse_angle(text) if " " in text else float(text)) == value


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("compass-passive-a", {"friction": 0.12, "walker.slope": "2 deg"}),
        ("compass-passive-a", {"friction.static": 0.15, "friction.kinetic": 0.12}),
        ("compass-passive-a", {"gait.phases": ["stick"], "impact_law": "frictionless"}),
        ("compass-pd-impact-slip", {"control.kp": 16, "control.reference.beyond_end": "hold"}),
        ("compass-virtual-constraint", {"control.reference.theta2.3": 0.42, "control.law": "pd"}),
        ("compass-table", {"control.kd": 6.0, "walker.slope": 0.01}),
        ("compass-torque-efficient", {"control.hip": 0.1}),
        ("rabbit-optimal", {"friction": 0.7}),
    ],
)
def test_changed_values_stand_beside_the_text_of_the_file(name: str, changes: dict[str, object]) -> None:
    problem = go.load_problem(name).replace(changes)
    source = write_problem(problem)
    assert source.text == problem.text
    assert source.changes
    assert same(read_problem(source), problem)


def test_a_problem_without_a_file_has_a_text_of_its_own() -> None:
    design = go.load_problem("compass-torque-efficient")
    problem = design.with_fixed({"control.ankle": 0.44, "control.hip": 0.11})  # has lost objective and constraints
    source = write_problem(problem)
    assert source.text != problem.text
    assert same(read_problem(source), problem)
    assert ExactValues(source)("control.ankle", 0.44) == "0.44"


def test_a_reference_and_a_table_travel_with_the_text() -> None:
    source = write_problem(go.load_problem("compass-pd-impact-slip"))
    assert source.problems["compass-passive-b"].text == go.load_problem("compass-passive-b").text
    source = write_problem(go.load_problem("compass-table"))
    assert "theta2 [deg]" in source.files["compass-table.csv"]
    with pytest.raises(ProblemError, match=r"compass-table\.csv'?, which its text names, is missing"):
        read_problem(ProblemText(text=source.text))
    with pytest.raises(ProblemError, match=r"does not name 'other\.csv'"):
        read_problem(ProblemText(text=source.text, files={**source.files, "other.csv": ""}))


def test_decimals_are_those_of_the_file_the_changes_or_the_double() -> None:
    problem = go.load_problem("compass-passive-a").replace({"friction": 0.12})
    exact = ExactValues(write_problem(problem))
    assert exact("walker.slope", problem.walker.slope) == "1 deg"  # type: ignore[attr-defined]
    assert exact("friction", 0.12) == "0.12"
    assert exact("friction", 0.14) == "0.14"  # not the value that the texts state: its shortest decimal
    assert exact("walker.nothing", 0.1) == "0.1"
