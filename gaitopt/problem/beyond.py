"""What a word stands for that a problem file does not take: where it belongs instead, or that nothing expresses it."""

import re
from collections.abc import Mapping

BEYOND: Mapping[str, str] = {
    "knee": "a knee is a joint stop: kneed_walker has one, and its phases state it, {mode: stick, knee: free}",
    "roll|round|arc": "round_feet_compass has feet that roll: they stick where they touch the ground",
    "spring|stiff|damp": "torso_walker and telescopic_compass have springs and dampers, or a class of your own",
    "torso|trunk": "torso_walker has a torso",
    "telescop|retract": "telescopic_compass has telescopic legs",
    "push": "push_off_compass pushes off with its stance foot",
    "hop|jump|fly|airborne|running": "hopper and slip_runner leave the ground, in phases called flight",
    "limp|other_leg": "the legs of unequal_compass may differ",
    "support|both_feet": "both feet are on the ground in the instant of an impact alone",
    "bounc|rebound|restitution|elastic": "impacts are plastic, and nothing bounces",
    "stair|step_height|rough|terrain|obstacle": "the ground is a plane slope",
    "lateral|yaw|3d|width": "all motion is in a plane",
    "delay|observer|sampl|cpg": "a control is a function of the shape, its rates and the time since the impact",
}
"""By words that name it; what is said on the page on scope."""


def beyond(word: str) -> str:
    """Where what a word stands for belongs, in words; empty for most words."""
    return next((words for pattern, words in BEYOND.items() if re.search(pattern, word.lower())), "")
