"""The command line: options in, tables or JSON out, and an exit code for everything that can happen."""
