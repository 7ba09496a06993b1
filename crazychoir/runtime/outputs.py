"""Let standard output and standard error take any text: not every encoding has every character."""

import codecs
import sys
from io import TextIOWrapper

OUTPUT_ERRORS = "crazychoir.output"
"""Name of the error handler of standard output and standard error."""


def let_outputs_take_any_text() -> None:
    r"""Print characters that the encoding of the output lacks as escapes: \xfc or \u2192.

    This holds for standard output and standard error. Bytes of file names that are no characters
    are printed unchanged.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors=OUTPUT_ERRORS)


def _replace_character(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    characters = error.object[error.start : error.end]
    return b"".join(_output_bytes(character) for character in characters), error.end


def _output_bytes(character: str) -> bytes:
    """Return the byte that a lone surrogate stands for; for another character return an escape."""
    try:
        return character.encode("ascii", "surrogateescape")
    except UnicodeEncodeError:
        return character.encode("ascii", "backslashreplace")


codecs.register_error(OUTPUT_ERRORS, _replace_character)
