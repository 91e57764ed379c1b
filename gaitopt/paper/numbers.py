"""Every number that the paper prints, with what computes it again.

Nothing here is fitted to a printed digit: the gaits are those of the catalogue, and a number that differs says why, by
a reason out of ``reasons.py``, with what another reading of the paper would give.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from gaitopt.paper.archive import Archive
from gaitopt.paper.copied_torques import mean_torques
from gaitopt.paper.gaits import family_of, gait_of, rounded_torques
from gaitopt.paper.reasons import Reason

Compute = Callable[[Archive], float]


@dataclass(frozen=True, slots=True, kw_only=True)
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


def _wheel() -> Iterator[Printed]:
    yield Printed(
        where="III-B", quantity="λ = β², no slip", printed="0.734", compute=scalar("wheel", "spectral_radius")
    )
    yield Printed(where="Fig. 3", quantity="μ_c", printed="0.91", compute=scalar("wheel", "required_friction"))
    yield Printed(where="Fig. 3", quantity="impulse ratio", printed="0.24", compute=scalar("wheel", "impulse_ratio"))
    yield Printed(where="III-B", quantity="largest rise of λ by slip [%]", printed="5", compute=_rise)
    yield Printed(
        where="III-B",
        quantity="μ below which the impact cannot stick",
        printed="0.25",
        compute=special("wheel", "impact_change"),
    )


def _passive() -> Iterator[Printed]:
    rows = (
        ("IV", "θ1* [rad]", "-0.149", "theta1", Reason.UNEXPLAINED),
        ("IV", "θ̇1* [rad/s]", "0.733", "dtheta1", Reason.LEG_LENGTH),
        ("IV", "θ̇2* [rad/s]", "-0.501", "dtheta2", Reason.LEG_LENGTH),
        ("IV", "|λ|, no slip", "0.71", "spectral_radius", Reason.LEG_LENGTH),
        ("IV, Fig. 7", "μ_c", "0.175", "required_friction", Reason.LEG_LENGTH),
        ("IV, Fig. 7", "impulse ratio", "0.145", "impulse_ratio", Reason.LEG_LENGTH),
    )
    for where, quantity, printed, key, reason in rows:
        yield Printed(
            where=where,
            quantity=quantity,
            printed=printed,
            compute=scalar("passive", key),
            reason=reason,
            otherwise={"leg as printed": scalar("passive, leg as printed", key)},
        )


def _slipping() -> Iterator[Printed]:
    free = "B, frictionless impact"
    yield Printed(where="IV", quantity="A: |λ| at μ = 0.14", printed="0.8", compute=scalar("A", "spectral_radius"))
    yield Printed(where="V", quantity="A: period [s]", printed="0.75", compute=scalar("A", "period"))
    yield Printed(
        where="IV, Fig. 9",
        quantity="A: unstable below μ",
        printed="0.11",
        compute=special("passive", "neimark_sacker"),
    )
    yield Printed(
        where="IV",
        quantity="B: |λ| at μ = 0.14",
        printed="2.76",
        compute=scalar("B", "spectral_radius"),
        reason=Reason.FRICTIONLESS_IMPACT,
        otherwise={"frictionless impact": scalar(free, "spectral_radius")},
    )
    yield Printed(
        where="V",
        quantity="B: period [s]",
        printed="0.7",
        compute=scalar("B", "period"),
        reason=Reason.UNEXPLAINED,
        otherwise={"frictionless impact": scalar(free, "period")},
    )
    yield Printed(
        where="V",
        quantity="B: angle at impact over that of A",
        printed="0.5",
        compute=ratio(scalar("B", "theta1"), scalar("A", "theta1")),
        reason=Reason.FRICTIONLESS_IMPACT,
        otherwise={"frictionless impact": ratio(scalar(free, "theta1"), scalar("A", "theta1"))},
    )
    yield Printed(
        where="IV, Fig. 9",
        quantity="B: found up to μ",
        printed="0.3",
        compute=special("B", "impact_change"),
    )


def _controlled() -> Iterator[Printed]:
    free = "II, frictionless impact"
    for which, printed in enumerate(("-2.73", "0.54")):
        yield Printed(
            where="V, Fig. 10",
            quantity=f"I: τ{which + 1}, mean [N m]",
            printed=printed,
            compute=printed_torque("passive", which),
            reason=Reason.TORQUE_SIGN,
        )
    yield _torque_row("I", "cost of transport", "0.0173", "cost_of_transport", Reason.UNEXPLAINED)
    yield Printed(where="V", quantity="I: speed [m/s]", printed="0.63", compute=scalar("I", "speed"))
    yield _torque_row("I", "|λ|, no slip", "0.713", "spectral_radius")
    yield _torque_row("I", "μ_c", "0.194", "required_friction")
    yield Printed(
        where="V, Fig. 12", quantity="I: unstable below μ", printed="0.103", compute=special("I", "neimark_sacker")
    )
    for which, printed in enumerate(("-0.69", "0.12")):
        yield Printed(
            where="V",
            quantity=f"II: τ{which + 1}, mean [N m], copying gait B",
            printed=printed,
            compute=printed_torque("B", which),
            reason=Reason.UNEXPLAINED,
        )
    yield Printed(
        where="V", quantity="II: cost of transport", printed="0.0044", compute=scalar("II", "cost_of_transport")
    )
    for quantity, printed, key, reason in (
        ("speed [m/s]", "0.31", "speed", Reason.UNEXPLAINED),
        ("|λ| at μ = 0.2", "1.225", "spectral_radius", Reason.FRICTIONLESS_IMPACT),
    ):
        yield Printed(
            where="V",
            quantity=f"II: {quantity}",
            printed=printed,
            compute=scalar("II", key),
            reason=reason,
            otherwise={
                "frictionless impact": scalar(free, key),
                **{f"frictionless impact, {words}": c for words, c in within_rounding(free, key).items()},
            },
        )
    for quantity, printed, key in (
        ("cost of transport", "0.0055", "cost_of_transport"),
        ("|λ| at μ = 0.2", "0.37", "spectral_radius"),
    ):
        yield Printed(
            where="V",
            quantity=f"III: {quantity}",
            printed=printed,
            compute=scalar("III", key),
            reason=Reason.REFERENCE_END,
            otherwise={end: scalar(f"III, {end}", key) for end in ("linear", "hold", "off")},
        )


def _torque_row(name: str, quantity: str, printed: str, key: str, reason: Reason = Reason.ROUNDING) -> Printed:
    return Printed(
        where="V",
        quantity=f"{name}: {quantity}",
        printed=printed,
        compute=scalar(name, key),
        reason=reason,
        otherwise=within_rounding(name, key),
    )


NUMBERS = (*_wheel(), *_passive(), *_slipping(), *_controlled())
"""All of them, in the order of the text."""
