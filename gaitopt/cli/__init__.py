"""The command line: reading options, printing results, exit codes."""
