"""Problem files: YAML to ``Problem`` and back, with errors that name line, key, value and remedy.

source        names, files and YAML text: plain data, and the line and column of every key
faults        what is wrong with a value, and where: one line per fault
schema        the sections of a file as pydantic models, and their JSON Schema
statement     what is required of a gait, complete and in SI; the same as data
reading       from data to the fields of a statement
plausibility  numbers that are impossible or unusual for the walker
scalars       the table of scalars of a gait: words, unit, range, formula
problem       ``Problem``: a statement with its source; load, replace, restore
"""
