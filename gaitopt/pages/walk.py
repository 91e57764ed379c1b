"""The report of a simulated walk: how it ended, its states step by step, and the animation over all steps."""

from base64 import b64encode

from gaitopt.figures.film import film
from gaitopt.figures.labels import symbol
from gaitopt.figures.motion import motion_of_walk
from gaitopt.figures.style import drawn
from gaitopt.figures.walk import section_states
from gaitopt.pages.page import provenance, render
from gaitopt.problem.scalars import state_unit
from gaitopt.study.simulate import Walk


def walk_report(walk: Walk) -> str:
    """HTML of a walk."""
    names = [name for name in walk.system.state_names if name != "x"]
    columns = [walk.system.state_names.index(name) for name in names]
    states = walk.trajectory.section_states[:, columns]
    impacts = ["start", *(str(step.impact.mode) for step in walk.complete_steps if step.impact is not None)]
    rows = zip(walk.section_times.tolist(), impacts, states.tolist(), strict=True)
    return render(
        "walk.html",
        title=walk.problem.name,
        about=walk.problem.about,
        walk=walk,
        columns=[f"{symbol(name)} [{state_unit(name)}]" for name in names],
        rows=[(t, impact.replace("_", " "), state) for t, impact, state in rows],
        picture=f"data:image/svg+xml;base64,{b64encode(drawn(section_states(walk), 'svg')).decode()}",
        data={"film": film(motion_of_walk(walk))},
        checks=[],
        origins=[provenance(walk.problem, {})],
    )
