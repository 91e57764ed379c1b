"""Problem files: YAML to ``Problem`` and back, with errors that name line, key, value and remedy.

- ``source``: names, files and YAML text; plain data with the line and column of every key
- ``faults``: errors in values with their places; one line per fault
- ``schema``: the sections of a file as pydantic models, and their JSON Schema
- ``scalars``: the table of scalars of a gait: label, unit, range, formula
- ``floor``: tiles of friction, height and slope under the feet of a walk, stated or random
- ``statement``: the problem statement, complete and in SI units; the same as data, changed by dotted key
- ``reading``: from data to the fields of a statement; walker, friction and control law, whose numbers may be free
- ``gait_section``: the cycle of a gait, what ends it, and the first guess; where a simulation starts
- ``design_section``: objective and constraints of a design, and the range over which it holds
- ``rules``: rules between the sections of a whole statement; numbers that are impossible or unusual for the walker
- ``problem``: ``Problem``, a statement with its source; loading, replacing, restoring
- ``writing``: a problem as texts from which it is read again, and the decimals that these give for its numbers
"""
