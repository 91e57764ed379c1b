"""What ``import gaitopt`` offers beside the results themselves: long calls with progress, figures, pages, files."""
