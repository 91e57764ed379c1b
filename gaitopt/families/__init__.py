"""Families of gaits: pseudo-arclength continuation through changes of the mode sequence."""

from gaitopt.families.family import follow_family as follow_family
from gaitopt.families.family import resumable as resumable
from gaitopt.families.request import Request as Request
from gaitopt.families.request import check_request as check_request
