"""Stored records: what is written has exactly the entries of its type and passes its check; spoiled numbers do not."""

import copy
import json
import re
from typing import Any

import pytest
from named import named, verification
from pydantic import TypeAdapter, ValidationError

import gaitopt as go
from gaitopt.gait.branch import ContinuationState
from gaitopt.gait.records import (
    CheckedGait,
    CheckedPoint,
    ClaimRecord,
    ContinuationStateRecord,
    GaitRecord,
    MultiplierRecord,
    PointRecord,
    SpecialRecord,
    StepRecord,
    VerificationRecord,
    first_fault,
)


def as_stored(record: Any) -> Any:
    return json.loads(json.dumps(record, allow_nan=False))


def undeclared(record: dict[str, Any], kind: Any) -> set[str]:
    """Entries that the type does not have, and required ones that the record does not have."""
    declared = kind.__required_keys__ | kind.__optional_keys__
    return (record.keys() - declared) | (kind.__required_keys__ - record.keys())


@pytest.mark.parametrize("name", ["rimless-wheel-slip", "compass-passive-two-step"])
def test_a_gait_writes_what_its_type_declares(name: str) -> None:
    record = as_stored(named(name).verified(verification(name).to_record()).to_record())
    TypeAdapter(CheckedGait).validate_python(record)
    assert undeclared(record, GaitRecord) == set()
    assert undeclared(record["multipliers"][0], MultiplierRecord) == set()
    assert undeclared(record["verification"], VerificationRecord) == set()
    assert undeclared(record["verification"]["claims"][0], ClaimRecord) == set()
    assert len(record.get("steps", ())) == (2 if record["n_steps"] == 2 else 0)
    assert all(undeclared(step, StepRecord) == set() for step in record.get("steps", ()))


@pytest.fixture(scope="module")
def branch() -> go.Branch:
    return go.continuation(named("rimless-wheel-stick"), "friction", 0.97, verify_every=0, progress=False)


def test_a_branch_writes_what_its_types_declare(branch: go.Branch) -> None:
    point, special = (as_stored(records[-1].to_record()) for records in (branch.points, branch.specials))
    TypeAdapter(CheckedPoint).validate_python(point)
    TypeAdapter(SpecialRecord).validate_python(special)
    assert undeclared(point, PointRecord) == set()
    assert undeclared(point["walk"], ContinuationStateRecord) == set()
    assert undeclared(special, SpecialRecord) == set()


def test_the_state_of_a_continuation_comes_back_with_every_bit(branch: go.Branch) -> None:
    state = branch[-1].walk
    assert state is not None
    again = ContinuationState.from_record(as_stored(state.to_record()))
    for name in ("unknowns", "direction", "metric"):
        assert getattr(again, name).tobytes() == getattr(state, name).tobytes()
    assert (again.arcs, again.origin, again.earlier) == (state.arcs, state.origin, state.earlier)


SPOILED = {
    "period": (lambda record: record.update(period=1.001 * record["period"]), "period is .* but the sum"),
    "radius": (lambda record: record.update(spectral_radius=0.1), "spectral_radius is .* the largest modulus"),
    "no multipliers": (lambda record: record.update(multipliers=[], spectral_radius=None), "spectral_radius"),
    "speed": (lambda record: record.update(speed=2 * record["speed"]), "speed times period"),
    "number of steps": (lambda record: record.update(n_steps=2), "number or the impact"),
    "no duration": (
        lambda record: record["phases"].append({**record["phases"][0], "duration": 0.0}),
        "Every duration must be greater than 0",
    ),
    "huge number": (lambda record: record["solver"].update(iterations=10**400), "solver"),
    "control character": (lambda record: record.update(message="\x1b[31m"), "Control characters"),
}


@pytest.mark.parametrize("what", SPOILED)
def test_a_spoiled_gait_is_refused_with_the_entry(what: str) -> None:
    record = as_stored(named("rimless-wheel-slip").to_record())
    spoil, words = SPOILED[what]
    spoiled = copy.deepcopy(record)
    spoil(spoiled)
    TypeAdapter(CheckedGait).validate_python(record)
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(CheckedGait).validate_python(spoiled)
    fault = first_fault(caught.value)
    assert len(fault) < 500
    assert re.search(words, fault), fault
