"""Long questions as the library offers them, with progress in words: why there is no gait, and whether it is proved."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from gaitopt.callbacks import Stop
from gaitopt.gait import Gait
from gaitopt.library.progress import Teller, shown, word_progress
from gaitopt.problem import Problem
from gaitopt.search.explain import Explanation
from gaitopt.search.explain import explain as explain_problem
from gaitopt.search.find import STARTS

if TYPE_CHECKING:
    from gaitopt.proof import Proof


def explain(
    problem: Problem,
    *,
    starts: int = STARTS,
    seed: int = 0,
    workers: int = 1,
    progress: Teller = True,
    should_stop: Stop = None,
) -> Explanation:
    """Why a problem has no gait: the violated conditions, what happens instead, and where the gait begins to exist.

    Parameters
    ----------
    starts, seed, workers : of the search for gaits of other mode sequences, see ``find``.
    progress : whether to show it, or a function of what is done next in words.
    should_stop : polled at every iteration.

    Raises
    ------
    KeyboardInterrupt
        If ``should_stop`` said so.
    """
    with shown(progress, word_progress, f"explaining {problem.name}") as say:
        return explain_problem(
            problem, starts=starts, seed=seed, workers=workers, progress=say, should_stop=should_stop
        )


def prove(gait: Gait, intervals: Mapping[str, str] | None = None, *, progress: Teller = True) -> "Proof":
    """Prove that a gait exists, is locally unique, has its mode sequence, and is stable or unstable.

    Parameters
    ----------
    gait : converged; nothing of it is trusted.
    intervals : parameters by dotted key for all of whose values this is to be proved, as ``0.18..0.25``. One with
        which the orbit moves is covered by boxes that follow the orbit.
    progress : whether to show it, or a function of how far the search is in words.

    Raises
    ------
    UnknownNameError
        If a key is no parameter of the gait.
    ValueError
        If an interval is not of that form.
    """
    from gaitopt.proof import prove as prove_gait  # which needs the extra

    with shown(progress, word_progress, f"proving {gait.problem.name}") as say:
        return prove_gait(gait, intervals, progress=say)
