"""Text that a terminal only shows: escape sequences and characters without a code in its encoding are spelled out."""

import sys
import unicodedata
from io import TextIOWrapper

KEPT = "\n\t"


def printable(text: str) -> str:
    r"""The text with control and format characters shown as escapes, \x1b for instance; line ends and tabs stay."""
    return "".join(char.encode("unicode_escape").decode("ascii") if _is_obeyed(char) else char for char in text)


def allow_any_encoding() -> None:
    r"""From now on, write characters that the encoding of stdout or stderr lacks as escapes, \xe9 for instance."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a caller may have put anything else there
            stream.reconfigure(errors="backslashreplace")


def _is_obeyed(char: str) -> bool:
    """Whether it is of the categories C (control, format, surrogate, ...), Zl or Zp (separators of lines)."""
    category = unicodedata.category(char)
    return char not in KEPT and (category[0] == "C" or category in ("Zl", "Zp"))
