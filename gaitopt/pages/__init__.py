"""Reports: a gait, a branch or a comparison of gaits as one offline HTML page."""

from gaitopt.pages.branch import branch_report
from gaitopt.pages.gait import comparison_report
from gaitopt.pages.walk import walk_report

__all__ = ["branch_report", "comparison_report", "walk_report"]
