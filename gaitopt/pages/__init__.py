"""Reports: a gait, a branch or a comparison of gaits as one offline HTML page."""

from gaitopt.pages.branch import branch_report as branch_report
from gaitopt.pages.gait import comparison_report as comparison_report
from gaitopt.pages.walk import walk_report as walk_report
