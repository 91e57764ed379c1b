"""The paper's figures by number; 1 and 5 are drawings of the models."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from matplotlib.figure import Figure

from gaitopt.figures.branches import over_parameter
from gaitopt.figures.force import force_ratio
from gaitopt.figures.labels import Parameter, label
from gaitopt.figures.motion import Motion, motion_of
from gaitopt.figures.portrait import phase_portrait
from gaitopt.figures.style import COLOURS, entry, legend_below, panels
from gaitopt.paper.archive import Archive, Records
from gaitopt.paper.copied_torques import copied_torques
from gaitopt.paper.gaits import FAMILIES, family_of, gait_of

CONSTANT = (0, (1.2, 1.4))
"""Line of the constants that approximate a torque."""
SAME = 1e-9
"""Coefficients of friction this close are the same."""
LAST = 10**9
"""Index of a point after all others of its branch."""


def _motions(archive: Archive, names: Mapping[str, str]) -> list[Motion]:
    return [motion_of(gait_of(archive, name), words) for name, words in names.items()]


def _families(archive: Archive, names: Mapping[str, str], quantity: str) -> Figure:
    return over_parameter(
        {words: _drawn(family_of(archive, name), FAMILIES[name]) for name, words in names.items()},
        Parameter(key="friction"),
        quantity,
    )


def _drawn(records: Records, targets: Sequence[float]) -> Records:
    """The records without the ends of the drawn range; where the family itself ends, its line goes on to the end."""
    ends = [record for record in records if record.get("type") == "end"]
    inner = [end for end in ends if min(abs(end["value"] - target) for target in targets) > SAME]
    last = [
        {**end["gait"], "record": "point", "branch": end["branch"], "index": LAST, "value": end["value"]}
        for end in inner
        if end["gait"]
    ]
    return [record for record in records if record not in ends] + last + inner


def _torques(archive: Archive) -> Figure:
    """Torques that copy the passive gait on level ground, and the constants of gait I beside them."""
    figure, (axes,) = panels()
    passive, constant = gait_of(archive, "passive"), gait_of(archive, "I")
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


WHEELS = MappingProxyType({"wheel": "no slip, μ = 1", "wheel slipping": "stick-slip, μ = 0.4"})
A_AND_B = MappingProxyType({"A": "A", "B": "B"})
A_AND_B_FRICTIONLESS = MappingProxyType({"A": "A", "B, frictionless impact": "B, frictionless impact"})
PASSIVE = MappingProxyType(
    {
        "passive": "sticking impact (A)",
        "B": "slipping impact (B)",
        "B, frictionless impact": "B, frictionless impact",
    }
)
CONTROLLED = MappingProxyType(
    {"I": "I, constant torques", "II": "II, weak torques", "II, frictionless impact": "II, frictionless impact"}
    | {"III": "III, PD law"}
)

FIGURES: Mapping[str, tuple[str, Callable[[Archive], Figure]]] = {
    "fig2": (
        "Rimless wheel: one step with and without slip",
        lambda archive: phase_portrait(_motions(archive, WHEELS)),
    ),
    "fig3": (
        "Rimless wheel without slip: force ratio over the angle",
        lambda archive: force_ratio(_motions(archive, {"wheel": "no slip"}), against="theta"),
    ),
    "fig4": (
        "Rimless wheel: multiplier over the coefficient of friction",
        lambda archive: _families(archive, {"wheel": "wheel"}, "spectral_radius"),
    ),
    "fig6": (
        "Passive compass without slip: one step",
        lambda archive: phase_portrait(_motions(archive, {"passive": "no slip"})),
    ),
    "fig7": (
        "Force ratio over one step: passive down 1 deg, and gait I on level ground",
        lambda archive: force_ratio(_motions(archive, {"passive": "passive", "I": "gait I"})),
    ),
    "fig8": (
        "Passive compass at friction 0.14: gaits A and B",
        lambda archive: phase_portrait(_motions(archive, A_AND_B)),
    ),
    "fig8-frictionless": (
        "The same, gait B with an impact that slips without friction",
        lambda archive: phase_portrait(_motions(archive, A_AND_B_FRICTIONLESS)),
    ),
    "fig9": (
        "Passive compass: largest multiplier over the coefficient of friction",
        lambda archive: _families(archive, PASSIVE, "spectral_radius"),
    ),
    "fig10": ("Torques that copy the passive gait on level ground", _torques),
    "fig11": (
        "Compass with motors: cost of transport over the coefficient of friction",
        lambda archive: _families(archive, CONTROLLED, "cost_of_transport"),
    ),
    "fig12": (
        "Compass with motors: largest multiplier over the coefficient of friction",
        lambda archive: _families(archive, CONTROLLED, "spectral_radius"),
    ),
}
"""What each figure shows, and what draws it."""
