"""Read the text files of a user: swarm files, instances, tables, drawings."""

from dataclasses import dataclass
from pathlib import Path

from crazychoir.errors import ConfigError


@dataclass(frozen=True, slots=True)
class TextMarks:
    """First characters and bytes that tell the encoding of a text."""

    byte_order_mark: str = "\ufeff"
    """The mark that may begin a text."""
    utf_8_mark: bytes = b"\xef\xbb\xbf"
    """The byte-order mark in UTF-8."""
    wide_marks: tuple[tuple[bytes, str], ...] = (
        (b"\xff\xfe\x00\x00", "UTF-32"),
        (b"\x00\x00\xfe\xff", "UTF-32"),
        (b"\xff\xfe", "UTF-16"),
        (b"\xfe\xff", "UTF-16"),
    )
    """First bytes of texts in other encodings, longer ones first."""


TEXT_MARKS = TextMarks()


UTF_8_ADVICE = "Save it as UTF-8: with an editor, or by `iconv -f ENCODING -t UTF-8 FILE > NEW_FILE`."
"""Advice for a file in another encoding."""


def read_text(
    path: str | Path,
    allowed: str,
    *,
    kind: type[ConfigError] = ConfigError,
    do: str = "",
    exact: bool = False,
) -> str:
    """Return the text of a UTF-8 file.

    The text has no byte-order mark, and each line ends with a line feed.

    allowed: what the file may contain, for errors
    kind: class of the error
    do: what to do about a file that cannot be opened, for errors
    exact: keep the mark and the line ends, for a text that is written back
    Raises `kind`, a ConfigError, if the file cannot be read or has another encoding.
    """
    try:
        data = Path(path).read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise kind(str(path), describe_unreadable(error), allowed, do) from error
    return decode_text(data, str(path), allowed, kind=kind, exact=exact)


def describe_unreadable(error: OSError | ValueError) -> str:
    """Return what was found in place of a file that can be read."""
    reason = getattr(error, "strerror", None) or str(error)
    if isinstance(error, FileNotFoundError):
        return f"no file ({reason})"
    return f"a file that cannot be read ({reason})"


def decode_text(
    data: bytes,
    where: str,
    allowed: str,
    *,
    kind: type[ConfigError] = ConfigError,
    exact: bool = False,
) -> str:
    """Return the bytes of a file as text.

    where: name of the file for errors; the other arguments are the same as for `read_text`
    """
    for mark, encoding in TEXT_MARKS.wide_marks:
        if data.startswith(mark):
            found = f"a text in {encoding}, by its first bytes {mark.hex(' ')}"
            raise kind(
                where,
                found,
                f"{allowed}, in UTF-8",
                UTF_8_ADVICE.replace("ENCODING", encoding),
            )
    zero = data.find(b"\0")
    if zero >= 0:
        found = f"a zero byte at {_place(data, zero)}: UTF-16 without a byte-order mark, or no text"
        raise kind(where, found, f"{allowed}, in UTF-8", UTF_8_ADVICE)
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        found = f"bytes that are not UTF-8: {data[error.start]:#04x} at {_place(data, error.start)}"
        raise kind(where, found, f"{allowed}, in UTF-8", UTF_8_ADVICE) from error
    if exact:
        return text
    return (
        text.lstrip(TEXT_MARKS.byte_order_mark)
        .replace("\r\n", "\n")
        .replace("\r", "\n")
    )


def _place(data: bytes, position: int) -> str:
    """Return the line and column of a byte, both from 1; columns count characters."""
    before = (
        data[:position]
        .removeprefix(TEXT_MARKS.utf_8_mark)
        .replace(b"\r\n", b"\n")
        .replace(b"\r", b"\n")
    )
    line = before.count(b"\n") + 1
    column = len(before[before.rfind(b"\n") + 1 :].decode(errors="replace")) + 1
    return f"line {line}, column {column} (byte {position})"
