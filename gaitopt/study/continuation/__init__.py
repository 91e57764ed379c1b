"""Families of gaits: pseudo-arclength continuation through changes of the mode sequence."""

from gaitopt.study.continuation.family import continuation, follow_family

__all__ = ["continuation", "follow_family"]
