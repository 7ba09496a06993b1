"""What is printed where the encoding of the output lacks a character."""

import io
import os
import sys

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from crazychoir.runtime.outputs import OUTPUT_ERRORS, let_outputs_take_any_text

UMLAUT = "schön"
OTHER_BYTES = os.fsdecode(b"b\xfcse")
IN_ASCII = UMLAUT.encode().decode("ascii", "surrogateescape")

any_text = st.text(st.characters(exclude_categories=())) | st.binary().map(
    lambda data: data.decode("utf-8", "surrogateescape")
)


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8", "cp1252"])
@given(text=any_text)
@example(text=f"┏━ {UMLAUT} {OTHER_BYTES} {IN_ASCII} → \ud800")
def test_an_output_of_any_encoding_takes_any_text(encoding, text):
    written = io.BytesIO()
    stream = io.TextIOWrapper(written, encoding, errors=OUTPUT_ERRORS, newline="")
    stream.write(text)
    stream.flush()
    if encoding == "utf-8" and not any(
        "\ud800" <= c <= "\udc7f" or "\udd00" <= c <= "\udfff" for c in text
    ):
        assert written.getvalue() == text.encode("utf-8", "surrogateescape")


def test_the_outputs_of_this_process_are_made_to_take_any_text(monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), "ascii", errors="strict")
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(
        sys, "stderr", io.StringIO()
    )  # no stream of bytes: it takes any text as it is
    let_outputs_take_any_text()
    stream.write(f"{UMLAUT} {OTHER_BYTES}")
    stream.flush()
    assert stream.buffer.getvalue() == b"sch\\xf6n b\xfcse"
