"""The paper in one command: every figure and every printed number of Gamus & Or (2013), computed again."""

from gaitopt.paper.reproduction import reproduce as reproduce
