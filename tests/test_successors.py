"""Mode sequences that may follow an event."""

import pytest

from gaitopt.mechanics import Mode, ModeSequence
from gaitopt.study.continuation.monitors import Name, Reading
from gaitopt.study.continuation.successors import successors

T, F, B = Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD


def proposed(phases: tuple[Mode, ...], impact: Mode, kind: str, phase: int | None, where: float) -> list[ModeSequence]:
    return successors(ModeSequence(phases, impact), [(Name(kind, phase), Reading(0.0, where))])


@pytest.mark.parametrize(
    ("phases", "impact", "kind", "phase", "where", "first"),
    [
        ((T,), T, "cone_forward", 0, 0.0, ((F, T), T)),
        ((T,), T, "cone_forward", 0, 1.0, ((T, F), T)),
        ((T,), T, "cone_backward", 0, 0.5, ((T, B, T), T)),
        ((F, T), T, "cone_backward", 1, 1.0, ((F, T, B), T)),
        ((F, T, B), T, "duration", 2, 1.0, ((F, T), T)),
        ((T, F, T), T, "duration", 1, 1.0, ((T,), T)),
        ((F, T), F, "duration", 0, 1.0, ((T,), T)),
        ((F,), F, "slip_velocity", 0, 0.5, ((F, T, F), F)),
        ((T,), T, "impulse_cone_forward", None, 1.0, ((F, T), F)),
        ((F, T, B), T, "impulse_cone_forward", None, 1.0, ((F, T, B), F)),
        ((F, T), F, "impact_slip", None, 1.0, ((T,), T)),
    ],
)
def test_the_first_proposal_is_what_the_physics_suggests(
    phases: tuple[Mode, ...],
    impact: Mode,
    kind: str,
    phase: int | None,
    where: float,
    first: tuple[tuple[Mode, ...], Mode],
) -> None:
    assert proposed(phases, impact, kind, phase, where)[0] == ModeSequence(*first)


@pytest.mark.parametrize("kind", ["cone_forward", "slip_velocity", "duration"])
@pytest.mark.parametrize("phases", [(T,), (F, T), (F, T, B), (B, F, T, B)])
def test_proposals_differ_from_the_old_sequence_and_from_each_other_and_never_repeat_a_mode(
    phases: tuple[Mode, ...], kind: str
) -> None:
    for phase in range(len(phases)):
        found = proposed(phases, T, kind, phase, 0.5)
        assert ModeSequence(phases, T) not in found
        assert len(set(found)) == len(found)
        assert all(a is not b for s in found for a, b in zip(s.phases, s.phases[1:], strict=False))


def test_a_slipping_impact_is_followed_by_its_slip() -> None:
    for kind in ("duration", "slip_velocity"):
        for sequence in proposed((F, T), F, kind, 0, 0.5):
            assert sequence.impact is T or sequence.phases[0] is sequence.impact
