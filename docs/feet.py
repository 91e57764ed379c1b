"""Draws the animations of docs/zoo.md, one of each walker with several contacts: ``python docs/feet.py``."""

from pathlib import Path

import gaitopt as go

NAMES = ("heel-toe-slip", "flat-foot", "slip-walk", "bounding", "crawler", "inchworm")

if __name__ == "__main__":
    for name in NAMES:
        go.solve(name).animate().save(Path(__file__).with_name(f"{name}.gif"))
