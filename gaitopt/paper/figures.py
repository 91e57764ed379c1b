"""The paper's figures by number; 1 and 5 are drawings of the models."""

from collections.abc import Callable, Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import gaitopt as go
from gaitopt.paper.gaits import FAMILIES, SHOWN, Archive, Records, copied_torques, family_of, gait_of

Draw = Callable[[Archive, Mapping[str, str]], Axes]

COLOURS, NEUTRAL = ("#0072b2", "#d55e00"), "#4d4d4d"
"""Colours of the two torques, and of legend entries that stand for both."""
CONSTANT_STYLE = (0, (1.2, 1.4))
"""Line style of the constant torques."""
SIZE = (6.0, 4.0)
"""Width and height of a figure [inch]."""
SAME_FRICTION = 1e-9
"""Largest difference of coefficients of friction that count as equal."""
INDEX_OF_END = 10**9
"""Index that places the end of a family after all points of its branch."""


def _gaits(what: str) -> Draw:
    return lambda archive, names: go.plot({label: gait_of(archive, name) for name, label in names.items()}, what)


def _families(quantity: str) -> Draw:
    def draw(archive: Archive, names: Mapping[str, str]) -> Axes:
        families = {label: _drawn(family_of(archive, name), FAMILIES[name]) for name, label in names.items()}
        return go.plot(families, quantity)

    return draw


def _drawn(records: Records, targets: Sequence[float]) -> Records:
    """The records of a family for a figure.

    An end at a target is left out, because the family continues beyond it. The line is drawn up to any other end.
    """
    ends = [record for record in records if record.get("type") == "end"]
    inner = [end for end in ends if min(abs(end["value"] - target) for target in targets) > SAME_FRICTION]
    last = [
        {**end["gait"], "record": "point", "branch": end["branch"], "index": INDEX_OF_END, "value": end["value"]}
        for end in inner
        if end["gait"]
    ]
    return [record for record in records if record not in ends] + last + inner


def _torques(archive: Archive, names: Mapping[str, str]) -> Axes:
    """Torques that copy the passive gait on level ground, and the constants of gait I beside them."""
    passive, constant = (gait_of(archive, name) for name in names)
    handles = []
    with go.figure_style():
        figure = Figure(figsize=SIZE)
        axes = figure.subplots()
        for k, (name, colour) in enumerate(zip(passive.system.walker.actuators, COLOURS, strict=True)):
            for times, torques in copied_torques(passive):
                axes.plot(times, torques[:, k], color=colour)
            value = constant.problem.parameters[f"control.{name}"]
            axes.axhline(value, color=colour, linestyle=CONSTANT_STYLE, linewidth=1.3)
            handles.append(Line2D([], [], label=name, color=colour))
        axes.set_ylim(bottom=0)
        axes.set_xlabel("time since impact [s]")
        axes.set_ylabel("torque [N m]")
        handles.append(Line2D([], [], label="copies the passive gait on level ground", color=NEUTRAL))
        handles.append(Line2D([], [], label="constant, gait I", color=NEUTRAL, linestyle=CONSTANT_STYLE, linewidth=1.3))
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return axes


FIGURES: Mapping[str, Draw] = {
    "fig2": _gaits("portrait"),
    "fig3": _gaits("force_over_theta"),
    "fig4": _families("spectral_radius"),
    "fig6": _gaits("portrait"),
    "fig7": _gaits("force"),
    "fig8": _gaits("portrait"),
    "fig8-frictionless": _gaits("portrait"),
    "fig9": _families("spectral_radius"),
    "fig10": _torques,
    "fig11": _families("cost_of_transport"),
    "fig12": _families("spectral_radius"),
}
"""The function that draws each figure."""


def draw(archive: Archive, name: str) -> Axes:
    """Draw the figure with this name."""
    return FIGURES[name](archive, SHOWN[name])
