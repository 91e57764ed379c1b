"""Text that a terminal only shows: what comes from files may hold sequences that it would obey."""

import unicodedata

KEPT = "\n\t"


def printable(text: str) -> str:
    r"""The text with control and format characters shown as escapes, \x1b for instance; line ends and tabs stay."""
    return "".join(char.encode("unicode_escape").decode("ascii") if _is_obeyed(char) else char for char in text)


def _is_obeyed(char: str) -> bool:
    """Whether it is of the categories C (control, format, surrogate, ...), Zl or Zp (separators of lines)."""
    category = unicodedata.category(char)
    return char not in KEPT and (category[0] == "C" or category in ("Zl", "Zp"))
