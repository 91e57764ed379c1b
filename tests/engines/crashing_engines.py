"""Adapters that fail, in a module that the process of an engine can import."""

import os

import numpy as np


class Crashing:
    """Aborts its process at small time steps."""

    name, version = "crashing", "1"
    settings = {"default": {}}  # noqa: RUF012

    def __init__(self, tree, friction, dt, settings):
        if dt < 1e-3:
            os.abort()
        self.q = self.v = None

    def place(self, q, v):
        self.q, self.v = q, v

    def step(self, force, touching):
        return self.q, self.v, np.zeros((2, 2))


class Diverging(Crashing):
    """Doubles its rates in every step."""

    name = "diverging"

    def step(self, force, touching):
        self.v = 2 * self.v
        return self.q, self.v, np.zeros((2, 2))


class Failing(Crashing):
    """Raises an error of its own."""

    name = "failing"

    def step(self, force, touching):
        raise RuntimeError("the contact solver does not converge\nmore lines")


class Hanging(Crashing):
    """Needs more time than there is."""

    name = "hanging"

    def step(self, force, touching):
        import time

        time.sleep(60)
