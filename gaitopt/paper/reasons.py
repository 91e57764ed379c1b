"""Why a computed number may differ from the printed one: the whole list, in one place."""

from enum import StrEnum


class Reason(StrEnum):
    """A reason, as the table of numbers gives it."""

    LEG_LENGTH = "leg length"
    TORQUE_SIGN = "torque sign"
    FRICTIONLESS_IMPACT = "frictionless impact"
    REFERENCE_END = "unspecified reference end"
    ROUNDING = "rounding"
    UNEXPLAINED = "unexplained"


EXPLANATIONS = {
    Reason.LEG_LENGTH: (
        "The paper prints leg length 0.8 and mass position 0.5. Its numbers belong to a leg of 1.6 m with the mass in "
        "its middle, 0.8 m from the foot, which is what we use. Taken literally, the printed lengths give another gait."
    ),
    Reason.TORQUE_SIGN: (
        "With the printed matrix E the printed constant torques would brake. They belong to a motor with the opposite "
        "sign; the same generalised forces are ankle = -tau1 - 2 tau2 and hip = tau2 here."
    ),
    Reason.FRICTIONLESS_IMPACT: (
        "We let a slipping impact obey Coulomb's law, eqs (10) and (11). The printed number is nearer to an impact "
        "that slips without any tangential impulse, which is also computed."
    ),
    Reason.REFERENCE_END: (
        "A step of gait III outlasts the reference that it tracks, and the paper does not say what the reference is "
        "beyond its end. We let it flow on along its own motion; the other readings are computed too."
    ),
    Reason.ROUNDING: (
        "The number depends on torques that are printed with two decimals. Over all torques that round to the printed "
        "ones the computed number covers the range given."
    ),
    Reason.UNEXPLAINED: "We know of no reason.",
}
"""Each reason in words."""
