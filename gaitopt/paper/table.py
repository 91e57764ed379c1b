"""The table of the reproduction: printed numbers and statements compared with computed ones, as Markdown and JSON.

``NUMBERS`` lists the printed numbers with the functions that compute them. ``SENTENCES`` lists the statements without a
number, which are examined on the computed families. A number that differs has one of the reasons in ``EXPLANATIONS``,
with the values that other readings of the paper give. Nothing is fitted to a printed digit.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from gaitopt.paper.gaits import Archive, Array, family_of, gait_of, mean_torques, rounded_torques


class Reason(StrEnum):
    """Why a computed number may differ from the printed one."""

    LEG_LENGTH = "leg length"
    TORQUE_SIGN = "torque sign"
    FRICTIONLESS_IMPACT = "frictionless impact"
    REFERENCE_END = "unspecified reference end"
    ROUNDING = "rounding"
    UNEXPLAINED = "unexplained"


EXPLANATIONS = {
    Reason.LEG_LENGTH: (
        "The paper prints leg length 0.8 and mass position 0.5. Its numbers belong to a leg of 1.6 m with the mass in "
        "its middle, 0.8 m from the foot, which we use. The printed lengths give another gait."
    ),
    Reason.TORQUE_SIGN: (
        "With the printed matrix E the printed constant torques would brake. They belong to a motor with the opposite "
        "sign; the same generalised forces are ankle = -tau1 - 2 tau2 and hip = tau2 here."
    ),
    Reason.FRICTIONLESS_IMPACT: (
        "We let a slipping impact obey Coulomb's law, eqs (10) and (11). The printed number is closer to that of a "
        "slipping impact without tangential impulse, which is also computed."
    ),
    Reason.REFERENCE_END: (
        "A step of gait III outlasts the reference that it tracks, and the paper does not say what the reference is "
        "beyond its end. Here the reference continues along its own motion; the other readings are computed too."
    ),
    Reason.ROUNDING: (
        "The number depends on torques that are printed with two decimals. The range is that of the computed number "
        "over all torques that round to the printed ones."
    ),
    Reason.UNEXPLAINED: "We know of no reason.",
}
"""The text that explains each reason."""


Compute = Callable[[Archive], float]


@dataclass(frozen=True, slots=True)
class Printed:
    """A printed number.

    Attributes
    ----------
    where : section or figure of the paper.
    quantity : the quantity with its unit.
    printed : the printed digits.
    compute : the function that computes the number.
    reason : why the computed number differs, or how the paper must be read to make it agree.
    otherwise : functions that compute the number for other readings of the paper, by the name of the reading.
    """

    where: str
    quantity: str
    printed: str
    compute: Compute
    reason: Reason | None = None
    otherwise: Mapping[str, Compute] = field(default_factory=dict)

    @property
    def half_digit(self) -> float:
        """Half a unit of the last printed digit."""
        return 0.5 * 10.0 ** -len(self.printed.partition(".")[2])


def scalar(name: str, key: str) -> Compute:
    """A scalar of a gait, or a coordinate of its state after the impact."""

    def compute(archive: Archive) -> float:
        gait = gait_of(archive, name)
        return gait.scalar(f"state.{key}" if key in gait.system.state_names else key)

    return compute


def special(name: str, kind: str) -> Compute:
    """The coefficient of friction at the first special point of a kind on a family."""
    return lambda archive: next(r["value"] for r in family_of(archive, name) if r.get("type") == kind)


def ratio(first: Compute, second: Compute) -> Compute:
    """The quotient of two numbers."""
    return lambda archive: first(archive) / second(archive)


def within_rounding(name: str, key: str) -> dict[str, Compute]:
    """Smallest and largest value over the torques that round to the printed ones."""

    def extreme(pick: Callable[[list[float]], float]) -> Compute:
        def compute(archive: Archive) -> float:
            values = [
                g.spectral_radius if key == "spectral_radius" else g.measures[key]
                for g in rounded_torques(archive, name)
            ]
            return pick([value for value in values if value is not None])

        return compute

    return {"least within the rounding of the torques": extreme(min), "most": extreme(max)}


def printed_torque(name: str, which: int) -> Compute:
    """tau1 or tau2 of the paper, averaged over the motion of a gait copied on level ground."""

    def compute(archive: Archive) -> float:
        ankle, hip = mean_torques(gait_of(archive, name))
        return float((-ankle - 2 * hip, hip)[which])

    return compute


def _rise(archive: Archive) -> float:
    """Largest increase of the wheel's multiplier by slip while its impact sticks [%]."""
    records = family_of(archive, "wheel")
    gaits = [r if r["record"] == "point" else r["gait"] for r in records if r["record"] in ("point", "special")]
    radii = [gait["spectral_radius"] for gait in gaits if gait.get("impact") == "stick"]
    return 100 * (max(radii) / radii[0] - 1)


def _torque_row(name: str, quantity: str, printed: str, key: str, reason: Reason = Reason.ROUNDING) -> Printed:
    return Printed("V", f"{name}: {quantity}", printed, scalar(name, key), reason, within_rounding(name, key))


def _passive_row(where: str, quantity: str, printed: str, key: str, reason: Reason = Reason.LEG_LENGTH) -> Printed:
    otherwise = {"leg as printed": scalar("passive, leg as printed", key)}
    return Printed(where, quantity, printed, scalar("passive", key), reason, otherwise)


def _pd_row(quantity: str, printed: str, key: str) -> Printed:
    otherwise = {end: scalar(f"III, {end}", key) for end in ("linear", "hold", "off")}
    return Printed("V", f"III: {quantity}", printed, scalar("III", key), Reason.REFERENCE_END, otherwise)


def _frictionless(name: str, key: str) -> dict[str, Compute]:
    return {"frictionless impact": scalar(f"{name}, frictionless impact", key)}


def _weak_row(quantity: str, printed: str, key: str, reason: Reason) -> Printed:
    rounded = within_rounding("II, frictionless impact", key)
    otherwise = _frictionless("II", key) | {f"frictionless impact, {name}": c for name, c in rounded.items()}
    return Printed("V", f"II: {quantity}", printed, scalar("II", key), reason, otherwise)


NUMBERS = (
    Printed("III-B", "λ = β², no slip", "0.734", scalar("wheel", "spectral_radius")),
    Printed("Fig. 3", "μ_c", "0.91", scalar("wheel", "required_friction")),
    Printed("Fig. 3", "impulse ratio", "0.24", scalar("wheel", "impulse_ratio")),
    Printed("III-B", "largest rise of λ by slip [%]", "5", _rise),
    Printed("III-B", "μ below which the impact cannot stick", "0.25", special("wheel", "impact_change")),
    _passive_row("IV", "θ1* [rad]", "-0.149", "theta1", Reason.UNEXPLAINED),
    _passive_row("IV", "θ̇1* [rad/s]", "0.733", "dtheta1"),
    _passive_row("IV", "θ̇2* [rad/s]", "-0.501", "dtheta2"),
    _passive_row("IV", "|λ|, no slip", "0.71", "spectral_radius"),
    _passive_row("IV, Fig. 7", "μ_c", "0.175", "required_friction"),
    _passive_row("IV, Fig. 7", "impulse ratio", "0.145", "impulse_ratio"),
    Printed("IV", "A: |λ| at μ = 0.14", "0.8", scalar("A", "spectral_radius")),
    Printed("V", "A: period [s]", "0.75", scalar("A", "period")),
    Printed("IV, Fig. 9", "A: unstable below μ", "0.11", special("passive", "neimark_sacker")),
    Printed(
        "IV", "B: |λ| at μ = 0.14", "2.76", scalar("B", "spectral_radius"),
        Reason.FRICTIONLESS_IMPACT, _frictionless("B", "spectral_radius"),
    ),
    Printed("V", "B: period [s]", "0.7", scalar("B", "period"), Reason.UNEXPLAINED, _frictionless("B", "period")),
    Printed(
        "V", "B: angle at impact over that of A", "0.5", ratio(scalar("B", "theta1"), scalar("A", "theta1")),
        Reason.FRICTIONLESS_IMPACT,
        {reading: ratio(angle, scalar("A", "theta1")) for reading, angle in _frictionless("B", "theta1").items()},
    ),
    Printed("IV, Fig. 9", "B: found up to μ", "0.3", special("B", "impact_change")),
    Printed("V, Fig. 10", "I: τ1, mean [N m]", "-2.73", printed_torque("passive", 0), Reason.TORQUE_SIGN),
    Printed("V, Fig. 10", "I: τ2, mean [N m]", "0.54", printed_torque("passive", 1), Reason.TORQUE_SIGN),
    _torque_row("I", "cost of transport", "0.0173", "cost_of_transport", Reason.UNEXPLAINED),
    Printed("V", "I: speed [m/s]", "0.63", scalar("I", "speed")),
    _torque_row("I", "|λ|, no slip", "0.713", "spectral_radius"),
    _torque_row("I", "μ_c", "0.194", "required_friction"),
    Printed("V, Fig. 12", "I: unstable below μ", "0.103", special("I", "neimark_sacker")),
    Printed("V", "II: τ1, mean [N m], copying gait B", "-0.69", printed_torque("B", 0), Reason.UNEXPLAINED),
    Printed("V", "II: τ2, mean [N m], copying gait B", "0.12", printed_torque("B", 1), Reason.UNEXPLAINED),
    Printed("V", "II: cost of transport", "0.0044", scalar("II", "cost_of_transport")),
    _weak_row("speed [m/s]", "0.31", "speed", Reason.UNEXPLAINED),
    _weak_row("|λ| at μ = 0.2", "1.225", "spectral_radius", Reason.FRICTIONLESS_IMPACT),
    _pd_row("cost of transport", "0.0055", "cost_of_transport"),
    _pd_row("|λ| at μ = 0.2", "0.37", "spectral_radius"),
)  # fmt: skip
"""All printed numbers, in the order of the paper."""


LINE_WIDTH = 1e-3
"""Width of a drawn line, relative to the height of its curve. A smaller change of the curve cannot be seen in print."""


@dataclass(frozen=True, slots=True)
class Sentence:
    """A statement of the paper without a number.

    Attributes
    ----------
    where : section or figure of the paper.
    text : the statement.
    holds : the function that tells whether the statement is true.
    """

    where: str
    text: str
    holds: Callable[[Archive], bool]


def _column(archive: Archive, name: str, key: str, *, slipping_impact: bool = False) -> Array:
    """A scalar at the points of a family, in the order of decreasing friction."""
    points = [record for record in family_of(archive, name) if record["record"] == "point"]
    points.sort(key=lambda record: -record["value"])
    return np.array([p[key] for p in points if not slipping_impact or p["impact"] != "stick"])


def _rises(values: Array) -> bool:
    """Whether a curve never falls by more than the width of its drawn line."""
    return bool(np.all(np.diff(values) >= -LINE_WIDTH * np.ptp(values)))


def _rises_then_falls(values: Array) -> bool:
    top = int(np.argmax(values))
    return 0 < top < len(values) - 1 and _rises(values[: top + 1]) and _rises(-values[top:])


def _beyond_sticking(name: str, sticking: str) -> Callable[[Archive], bool]:
    """Whether gaits with a slipping impact exist at more friction than the sticking gait needs."""

    def holds(archive: Archive) -> bool:
        values = _column(archive, name, "value", slipping_impact=True)
        return bool(values.max() > scalar(sticking, "required_friction")(archive))

    return holds


SENTENCES = (
    Sentence(
        "IV, Fig. 9",
        "λ of A rises as friction falls",
        lambda archive: _rises(_column(archive, "passive", "spectral_radius")),
    ),
    Sentence(
        "IV, Fig. 9",
        "B is unstable throughout",
        lambda archive: bool(_column(archive, "B", "spectral_radius", slipping_impact=True).min() > 1),
    ),
    Sentence("IV", "B exists for μ > μ_c too", _beyond_sticking("B", "passive")),
    Sentence(
        "V, Fig. 11",
        "I: as friction falls, the cost first rises and then falls",
        lambda archive: _rises_then_falls(_column(archive, "I", "cost_of_transport")),
    ),
    Sentence("V", "I: the speed falls with the friction", lambda archive: _rises(-_column(archive, "I", "speed"))),
    Sentence(
        "V, Fig. 12",
        "I: λ rises as friction falls",
        lambda archive: _rises(_column(archive, "I", "spectral_radius")),
    ),
    Sentence("V", "II is unstable at μ = 0.2", lambda archive: scalar("II", "spectral_radius")(archive) > 1),
    Sentence(
        "V",
        "II costs a quarter of I, to one digit",
        lambda archive: round(ratio(scalar("I", "cost_of_transport"), scalar("II", "cost_of_transport"))(archive)) == 4,
    ),
    Sentence("V", "III is stable at μ = 0.2", lambda archive: scalar("III", "spectral_radius")(archive) < 1),
    Sentence("V", "III slips after the impact for μ > μ_c of I too", _beyond_sticking("III", "I")),
)
"""All statements, in the order of the paper."""


ROUNDING = 1e-9
"""Addition to half a digit, so that rounding does not decide about a number exactly half a digit away."""
MARKDOWN_DIGITS = 5
"""Number of significant digits in the Markdown table; the JSON has all digits."""
INTRODUCTION = """# Gamus & Or (2013): every printed number, computed again

Written by `gaitopt reproduce gamus-or-2013`. *agrees* means to the last printed digit. A reason is given where
a number differs, or agrees only if the paper is read differently; the reasons are listed below. Nothing was fitted to a
printed digit.
"""


def row(archive: Archive, number: Printed) -> dict[str, Any]:
    """One number as a JSON object."""
    computed = number.compute(archive)
    difference = computed - float(number.printed)
    return {
        "where": number.where,
        "quantity": number.quantity,
        "printed": number.printed,
        "computed": computed,
        "difference": difference,
        "agrees": abs(difference) <= number.half_digit + ROUNDING,
        "reason": None if number.reason is None else str(number.reason),
        "otherwise": {reading: compute(archive) for reading, compute in number.otherwise.items()},
    }


def statement(archive: Archive, sentence: Sentence) -> dict[str, Any]:
    """One sentence as a JSON object."""
    return {"where": sentence.where, "sentence": sentence.text, "holds": sentence.holds(archive)}


def record(archive: Archive) -> dict[str, Any]:
    """The whole table as one JSON object."""
    return {
        "numbers": [row(archive, number) for number in NUMBERS],
        "sentences": [statement(archive, sentence) for sentence in SENTENCES],
        "reasons": {str(reason): text for reason, text in EXPLANATIONS.items()},
    }


def markdown(table: Mapping[str, Any]) -> str:
    """The table as Markdown."""
    reasons = [f"- **{reason}**: {EXPLANATIONS[reason]}" for reason in Reason]
    sections = (INTRODUCTION, *_numbers(table["numbers"]), "", "## Reasons", "", *reasons, "")
    return "\n".join([*sections, "## Statements without a number", "", *_sentences(table["sentences"]), ""])


def _numbers(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield _line("where", "quantity", "printed", "computed", "difference", "agrees", "reason", "otherwise")
    yield "|---|---|---:|---:|---:|---|---|---|"
    for entry in rows:
        yield _line(
            entry["where"],
            entry["quantity"].replace("|", "\\|"),
            entry["printed"],
            f"{entry['computed']:.{MARKDOWN_DIGITS}g}",
            f"{entry['difference']:+.2g}",
            "yes" if entry["agrees"] else "no",
            entry["reason"] or "",
            ", ".join(f"{reading}: {value:.{MARKDOWN_DIGITS}g}" for reading, value in entry["otherwise"].items()),
        )


def _sentences(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield _line("where", "the paper says", "holds")
    yield "|---|---|---|"
    for entry in rows:
        yield _line(entry["where"], entry["sentence"], "yes" if entry["holds"] else "no")


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"
