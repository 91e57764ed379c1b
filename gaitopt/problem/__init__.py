"""Problem files: YAML to ``Problem`` and back, with errors that name line, key, value and remedy."""
