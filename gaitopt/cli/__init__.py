"""The command line: options in, tables or JSON out, exit codes. It computes nothing; ``api`` does.

- ``main``: the program, its commands, and the exit code of every ending.
- ``problems``: ``list``, ``show``, ``validate``, ``schema``.
- ``gaits``: ``solve``, ``simulate``, ``verify``, ``find``, ``explain``, ``prove``.
- ``families``: ``continue``, ``front``, ``sweep``, ``basin``.
- ``pictures``: ``plot``, ``report``, ``reproduce``.
- ``runs``: the argument RUN, a run folder or a problem.
- ``options``: options that several commands take, and how their texts are read.
- ``terminal``, ``console``: output of results, narration and progress.
- ``signals``: Ctrl-C and SIGTERM.
"""
