"""Families of gaits: pseudo-arclength continuation through changes of the mode sequence."""

from gaitopt.families.family import Request, check_request, continuation, follow_family, resumable

__all__ = ["Request", "check_request", "continuation", "follow_family", "resumable"]
