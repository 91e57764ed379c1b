"""The command line: options in, tables or JSON out, exit codes. It computes nothing; ``api`` does.

- ``main``: the program, its commands, and the exit code of every ending.
- ``gaits``: ``solve``, ``simulate``, ``verify``, ``sensitivity``, ``robustness``, ``stabilise``, ``find``, ``explain``,
  ``prove``, ``replay``.
- ``families``: ``continue``, ``trace``, ``front``, ``sweep``, ``atlas``, ``attractors``, ``basin``.
- ``views``: ``list``, ``show``, ``validate``, ``schema``, ``plot``, ``report``, ``reproduce``.
- ``runs``: the argument RUN, a run folder or a problem.
- ``options``: options that several commands take, and how their texts are read.
- ``terminal``: output of results, narration and progress; Ctrl-C and SIGTERM.
"""
