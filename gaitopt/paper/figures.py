"""The paper's figures by number; 1 and 5 are drawings of the models."""

from collections.abc import Callable, Mapping, Sequence

from matplotlib.figure import Figure

import gaitopt as go
from gaitopt.paper.gaits import FAMILIES, SHOWN, Archive, Records, copied_torques, family_of, gait_of
from gaitopt.show.families import over_parameter
from gaitopt.show.gaits import force_ratio, phase_portrait
from gaitopt.show.labels import Parameter, label
from gaitopt.show.motion import Motion, motion_of
from gaitopt.show.style import COLOURS, entry, legend_below, panels

Draw = Callable[[Archive, Mapping[str, str]], Figure]

CONSTANT = (0, (1.2, 1.4))
"""Line style of the constant torques."""
SAME = 1e-9
"""Largest difference of coefficients of friction that count as equal."""
LAST = 10**9
"""Index of a point after all others of its branch."""


def _motions(archive: Archive, names: Mapping[str, str]) -> list[Motion]:
    return [motion_of(gait_of(archive, name), words) for name, words in names.items()]


def _drawn(records: Records, targets: Sequence[float]) -> Records:
    """The records without the ends at the targets; where the family itself ends, its line is drawn to the end."""
    ends = [record for record in records if record.get("type") == "end"]
    inner = [end for end in ends if min(abs(end["value"] - target) for target in targets) > SAME]
    last = [
        {**end["gait"], "record": "point", "branch": end["branch"], "index": LAST, "value": end["value"]}
        for end in inner
        if end["gait"]
    ]
    return [record for record in records if record not in ends] + last + inner


def _torques(passive: go.Gait, constant: go.Gait) -> Figure:
    """Torques that copy the passive gait on level ground, and the constants of gait I beside them."""
    figure, (axes,) = panels()
    handles = []
    for k, (name, colour) in enumerate(zip(passive.system.walker.actuators, COLOURS, strict=False)):
        for times, torques in copied_torques(passive):
            axes.plot(times, torques[:, k], color=colour)
        axes.axhline(constant.problem.parameters[f"control.{name}"], color=colour, linestyle=CONSTANT, linewidth=1.3)
        handles.append(entry(name, color=colour))
    axes.set_ylim(bottom=0)
    axes.set_xlabel(str(label("time")))
    axes.set_ylabel("torque [N m]")
    copies = entry("copies the passive gait on level ground")
    legend_below(figure, [*handles, copies, entry("constant, gait I", linestyle=CONSTANT, linewidth=1.3)])
    return figure


def _portrait(archive: Archive, names: Mapping[str, str]) -> Figure:
    return phase_portrait(_motions(archive, names))


def _over_friction(quantity: str) -> Draw:
    def draw(archive: Archive, names: Mapping[str, str]) -> Figure:
        families = {words: _drawn(family_of(archive, name), FAMILIES[name]) for name, words in names.items()}
        return over_parameter(families, Parameter(key="friction"), quantity)

    return draw


FIGURES: Mapping[str, Draw] = {
    "fig2": _portrait,
    "fig3": lambda archive, names: force_ratio(_motions(archive, names), against="theta"),
    "fig4": _over_friction("spectral_radius"),
    "fig6": _portrait,
    "fig7": lambda archive, names: force_ratio(_motions(archive, names)),
    "fig8": _portrait,
    "fig8-frictionless": _portrait,
    "fig9": _over_friction("spectral_radius"),
    "fig10": lambda archive, names: _torques(*(gait_of(archive, name) for name in names)),
    "fig11": _over_friction("cost_of_transport"),
    "fig12": _over_friction("spectral_radius"),
}
"""Draws each figure from the gaits in it."""


def draw(archive: Archive, name: str) -> Figure:
    """One figure."""
    return FIGURES[name](archive, SHOWN[name])
