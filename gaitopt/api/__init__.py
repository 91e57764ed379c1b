"""The public functions, each once."""
