"""Reports: a gait, a branch or a comparison of gaits as one offline HTML page."""

from gaitopt.report.branch import branch_report
from gaitopt.report.gait import comparison_report, gait_report

__all__ = ["branch_report", "comparison_report", "gait_report"]
