"""What modes and impacts assume, as margins that are positive while it holds: names, units, words, consequences.

The expressions of the margins are those of ``HybridSystem``; everything else that is known of a margin stands here.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gaitopt.arrays import Array, read_only
from gaitopt.model.modes import Mode
from gaitopt.model.units import UNITS, Scales
from gaitopt.model.walker import Walker


@dataclass(frozen=True, slots=True, kw_only=True)
class Margin:
    """One margin.

    Attributes
    ----------
    unit : its natural unit, a key of ``ranges.UNITS``.
    violated : words for a negative value, which replaces ``{value}``; empty where it is judged together with others.
    lost : words for its fall to zero, in a motion or along a branch.
    absent : words for a phase that it should end, but in which it does not fall.
    ending : how a motion ends where it falls (``gaitopt.gait.Ending``); None where a mode or the impact follows.
    onset : the slip that begins where it falls, if one does.
    rises : whether it is zero at the start of a step, so that it may fall only after it has been positive.
    """

    unit: str
    violated: str = ""
    lost: str
    absent: str = ""
    ending: str | None = None
    onset: Mode | None = None
    rises: bool = False


NO_SLIP = "sticking needs no more friction than there is before touchdown, so that no slip sets in"

PUSH_SLIPS = "the foot that pushes off slips: its push is {value:.4g} N s outside of the friction cone"
PUSH = ("push_cone_forward", "push_cone_backward", "push_landing")
"""Margins of the push before an impact."""

PHASE_MARGINS: Mapping[str, Margin] = {
    "touchdown": Margin(
        unit="one",
        lost="the swing foot touches the ground earlier in the step",
        absent="the swing foot does not come down",
        rises=True,
    ),
    "clearance": Margin(
        unit="length",
        lost="the swing foot scuffs the ground while a stop is still free",
        ending="scuffing",
        rises=True,
    ),
    "upright": Margin(unit="one", lost="the walker is no longer upright", ending="fall"),
    "normal_force": Margin(
        unit="force",
        violated="normal force is {value:.4g} N, must be positive",
        lost="the stance foot lifts off: its normal force falls to zero",
        absent="the foot does not leave the ground",
        ending="lift_off",
    ),
    "cone_forward": Margin(
        unit="force",
        lost="the force reaches the edge of the friction cone, the foot slips forward",
        absent=NO_SLIP,
        onset=Mode.SLIP_FORWARD,
    ),
    "cone_backward": Margin(
        unit="force",
        lost="the force reaches the edge of the friction cone, the foot slips backward",
        absent=NO_SLIP,
        onset=Mode.SLIP_BACKWARD,
    ),
    "slip_velocity": Margin(
        unit="speed",
        violated="slip velocity is {value:.4g} m/s in the direction of the mode, must not be negative",
        lost="the foot comes to rest",
        absent="the foot does not come to rest before touchdown",
    ),
    "painleve": Margin(
        unit="mass",
        violated="apparent mass of the slipping foot is {value:.4g} kg, must be positive (Painleve)",
        lost="the slip has no unique solution: the apparent mass of the foot falls to zero",
        ending="painleve",
    ),
    "onset": Margin(
        unit="force",
        violated="static friction holds the foot: the force misses the edge of its cone by {value:.4g} N",
        lost="static friction holds the foot where the slip should start",
    ),
}
"""Margins of phases. ``touchdown`` is minus the walker's guard; ``cone_forward`` is mu f_n + f_t, ``cone_backward``
mu f_n - f_t; ``slip_velocity`` is the speed in the mode's direction; ``onset`` the force beyond the static cone where a
slip starts from rest, needed only where friction has two coefficients."""

IMPACT_MARGINS: Mapping[str, Margin] = {
    "impulse": Margin(
        unit="impulse",
        violated="normal impulse is {value:.4g} N s, must be positive",
        lost="the normal impulse of the impact falls to zero",
        ending="lift_off",
    ),
    "lift_velocity": Margin(
        unit="speed",
        violated="the former stance foot does not lift: its normal velocity is {value:.4g} m/s",
        lost="the former stance foot no longer lifts at the impact",
        ending="double_support",
    ),
    "touchdown_rate": Margin(
        unit="rate",
        violated="the swing foot leaves the ground instead of landing (guard rate {value:.4g})",
        lost="the swing foot no longer comes down",
        ending="impact_inconsistent",
    ),
    "push_cone_forward": Margin(
        unit="impulse", violated=PUSH_SLIPS, lost="the foot that pushes off slips", ending="push_slips"
    ),
    "push_cone_backward": Margin(
        unit="impulse", violated=PUSH_SLIPS, lost="the foot that pushes off slips", ending="push_slips"
    ),
    "push_landing": Margin(
        unit="speed",
        violated="the push lifts the swing foot: it leaves the ground at {value:.4g} m/s instead of landing",
        lost="the push lifts the swing foot before it lands",
        ending="impact_inconsistent",
    ),
    "impulse_cone_forward": Margin(
        unit="impulse", lost="the impact can no longer stick, the foot slips forward", onset=Mode.SLIP_FORWARD
    ),
    "impulse_cone_backward": Margin(
        unit="impulse", lost="the impact can no longer stick, the foot slips backward", onset=Mode.SLIP_BACKWARD
    ),
    "impact_slip_velocity": Margin(
        unit="speed",
        violated="slip velocity after impact is {value:.4g} m/s in the direction of the mode",
        lost="the slip after the impact fades",
    ),
    "impact_painleve": Margin(
        unit="mass",
        violated="apparent mass of the colliding foot is {value:.4g} kg, must be positive",
        lost="the slipping impact has no unique solution any more",
        ending="painleve",
    ),
    "impact_onset": Margin(
        unit="impulse",
        violated="the impact sticks: its impulse misses the edge of the static cone by {value:.4g} N s",
        lost="static friction holds the impact: it can no longer slip",
    ),
}
"""Margins of impacts, with impulses in place of forces."""

MARGINS: Mapping[str, Margin] = {**PHASE_MARGINS, **IMPACT_MARGINS}
ONSETS: Mapping[str, Mode] = {name: known.onset for name, known in PHASE_MARGINS.items() if known.onset is not None}
"""The slip that begins where a margin of a sticking phase falls."""
STOP = Margin(
    unit="one",
    lost="the stop locks, or the switch is thrown, earlier in the step",
    absent="the stop does not lock, or the switch is not thrown",
    rises=True,
)
"""The gap of a joint stop, or the margin of a switch, under any name."""


def margin(name: str) -> Margin:
    """What is known of a margin."""
    return MARGINS.get(name, STOP)


@lru_cache(maxsize=256)
def margin_names(mode: Mode) -> tuple[str, ...]:
    """Names of the margins of a mode, in the order of ``HybridSystem.margins``; stops and switches by their names."""
    if mode.flies:
        return ("touchdown", "upright", *mode.free, *mode.off)
    contact = ("cone_forward", "cone_backward") if mode.sticks else ("slip_velocity", "painleve")
    return ("clearance" if mode.free else "touchdown", "upright", "normal_force", *contact, *mode.free, *mode.off)


def impact_margin_names(mode: Mode, walker: type[Walker], *, two_coefficients: bool) -> tuple[str, ...]:
    """Names of the margins of an impact, in the order of ``HybridSystem.impact_margins``.

    Parameters
    ----------
    walker : one that lands out of flight has no other foot that must lift; massless feet land without an impulse.
    two_coefficients : whether static and kinetic friction may differ.
    """
    if mode.flies:
        return ("lift_velocity",)
    if walker.massless_feet:
        return ("touchdown_rate",)
    lifts = () if walker.flies else ("lift_velocity",)
    common = ("impulse",) if mode.locked else ("impulse", *lifts, "touchdown_rate")
    if mode.sticks:
        return (*common, "impulse_cone_forward", "impulse_cone_backward")
    return (*common, "impact_slip_velocity", "impact_painleve", *(("impact_onset",) if two_coefficients else ()))


@lru_cache(maxsize=64)
def margin_scales(mode: Mode, scales: Scales) -> Array:
    """Natural unit of every margin of a mode, in the order of ``margin_names``; read-only."""
    return read_only(np.array([margin_unit(name, scales) for name in margin_names(mode)]))


def margin_unit(name: str, scales: Scales) -> float:
    """Natural unit of one margin of a phase or an impact."""
    return UNITS[margin(name).unit][1](scales)


def ending_margin(mode: Mode, after: Mode | None) -> str:
    """The margin whose fall to zero ends a phase in ``mode`` that is followed by ``after`` (None: the impact)."""
    if after is None:
        return "touchdown"
    thrown = [name for name in (*mode.free, *mode.off) if after.stops[name] != mode.stops[name]]
    if thrown:
        return thrown[0]
    if after.flies:
        return "normal_force"
    if mode.slips:
        return "slip_velocity"
    return next(name for name in margin_names(mode) if margin(name).onset is after.contact)
