"""Reproduction of Gamus & Or (2013)."""
