"""Every number that the paper prints, with what computes it again.

Nothing here is fitted to a printed digit: the gaits are those of the catalogue, and a number that differs says why, by
a reason out of ``reasons.py``, with what another reading of the paper would give.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from gaitopt.paper.archive import Archive
from gaitopt.paper.copied_torques import mean_torques
from gaitopt.paper.gaits import family_of, gait_of, rounded_torques
from gaitopt.paper.reasons import Reason

Compute = Callable[[Archive], float]


@dataclass(frozen=True, slots=True)
class Printed:
    """A printed number.

    Attributes
    ----------
    where : place in the paper.
    quantity : what it is, with its unit.
    printed : its digits.
    compute : computes it.
    reason : why it differs, or what had to be read differently so that it does not.
    otherwise : what other readings give, by their words.
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
    """By how much slipping raises the wheel's multiplier while its impact sticks [%]."""
    gaits = [record if record["record"] == "point" else record["gait"] for record in family_of(archive, "wheel")]
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
    otherwise = _frictionless("II", key) | {f"frictionless impact, {words}": c for words, c in rounded.items()}
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
        {words: ratio(angle, scalar("A", "theta1")) for words, angle in _frictionless("B", "theta1").items()},
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
"""All of them, in the order of the text."""
