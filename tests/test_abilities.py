"""The table of docs/abilities.md is true: every verb is run for every kind of walker."""

import pytest
from abilities import COLUMNS, GROUPS, PAGE, README, REASONS, ROWS, failure, page, readme


def test_the_pages_are_those_of_the_table():
    assert PAGE.read_text(encoding="utf-8") == page()
    assert README.read_text(encoding="utf-8") == readme()


def test_reasons_and_groups_are_of_cells_of_the_table():
    assert {*REASONS} <= {(row.name, column.name) for row in ROWS for column in COLUMNS}
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(column.name for column in COLUMNS)


@pytest.mark.slow
@pytest.mark.parametrize("column", COLUMNS, ids=lambda column: column.name)
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_the_verb_works_for_the_walker_or_a_reason_says_why_it_does_not(row, column):
    if (row.name, column.name) in REASONS:
        pytest.skip(REASONS[row.name, column.name])
    report = failure(row, column)
    assert not report, report
