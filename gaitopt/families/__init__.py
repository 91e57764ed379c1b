"""Families of gaits: pseudo-arclength continuation through changes of the mode sequence."""

from gaitopt.families.family import follow_family, resumable
from gaitopt.families.request import Request, check_request

__all__ = ["Request", "check_request", "follow_family", "resumable"]
