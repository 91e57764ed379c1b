"""The paper in one command: every figure and every printed number of Gamus & Or (2013), computed again."""

from gaitopt.paper.archive import Archive
from gaitopt.paper.reproduction import PAPERS, check_names, parts, reproduce

__all__ = ["PAPERS", "Archive", "check_names", "parts", "reproduce"]
