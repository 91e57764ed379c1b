"""Designs: gaits with free parameters, an objective and constraints."""
