"""Tables of contents: on disk whole or not at all, asked for once."""

import dataclasses
import threading

import pytest
from cflib.crazyflie.log import LogTocElement
from cflib.crazyflie.param import ParamTocElement

from crazychoir.radio.link import toc_cache as contents
from crazychoir.radio.link.toc_cache import TableOfContents


def log_table() -> contents.Contents:
    return {"pm": {"vbat": LogTocElement(0, b"\x07pm\0vbat\0")}}


def param_table() -> contents.Contents:
    return {
        "stabilizer": {"estimator": ParamTocElement(3, b"\x18stabilizer\0estimator\0")}
    }


def test_what_one_process_was_told_another_reads(tmp_path) -> None:
    for crc, table in ((0xABCD, log_table()), (0x12, param_table())):
        TableOfContents(tmp_path).insert(crc, table)
        found = TableOfContents(tmp_path).fetch(crc)
        ((group, ((name, mine),)),) = [
            (g, tuple(items.items())) for g, items in table.items()
        ]
        element = found[group][name]
        assert type(element) is type(mine)
        assert [getattr(element, f) for f in contents.ENTRY_FIELDS] == [
            getattr(mine, f) for f in contents.ENTRY_FIELDS
        ]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        '{"kind": "log"}',
        '{"kind": "os.system", "elements": []}',
        "[]",
        "null",
        '{"kind": "log", "elements": [[1, 2]]}',
    ],
)
def test_a_broken_file_is_asked_for_again(tmp_path, text, caplog) -> None:
    (tmp_path / "0000ABCD.json").write_text(text)
    assert TableOfContents(tmp_path).fetch(0xABCD) is None
    assert "requested from the drone again" in caplog.text


def test_the_second_link_waits_for_the_first_ones_answer(tmp_path) -> None:
    table, found = TableOfContents(tmp_path), []
    assert table.fetch(7) is None
    second = threading.Thread(target=lambda: found.append(table.fetch(7)))
    second.start()
    assert second.is_alive()
    told = log_table()
    table.insert(7, told)
    second.join(5.0)
    assert found == [told]


def test_it_waits_no_longer_than_its_patience(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(
        contents,
        "TABLE_WAIT",
        dataclasses.replace(contents.TABLE_WAIT, longest=0.05, check_period=0.05),
    )
    table, found = TableOfContents(tmp_path), []
    assert table.fetch(7) is None
    second = threading.Thread(target=lambda: found.append(table.fetch(7)))
    second.start()
    second.join(5.0)
    assert found == [None]


def test_a_repeated_fetch_does_not_wait_and_a_closed_link_blocks_no_other(
    tmp_path,
) -> None:
    table, found = TableOfContents(tmp_path), []
    assert table.fetch(7) is None
    assert table.fetch(7) is None
    second = threading.Thread(target=lambda: found.append(table.fetch(7)))
    second.start()
    table.forget(threading.get_ident())
    second.join(5.0)
    assert found == [None], "it asks its own drone now"


def test_a_folder_that_cannot_be_written_costs_time_and_nothing_else(
    tmp_path, caplog
) -> None:
    (tmp_path / "file").write_text("")
    table = TableOfContents(tmp_path / "file" / "below")
    told = log_table()
    table.insert(7, told)
    assert table.fetch(7) is told
    assert "not stored" in caplog.text


def test_nothing_half_written_is_left(tmp_path, monkeypatch) -> None:
    def fails(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(contents.os, "replace", fails)
    TableOfContents(tmp_path).insert(7, log_table())
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_damaged_and_still_json_is_asked_for_again(
    tmp_path, caplog
) -> None:
    table = TableOfContents(tmp_path)
    table.insert(7, log_table())
    (file,) = tmp_path.iterdir()
    for damaged in (
        file.read_text().replace("vbat", "vbaz"),
        "[" * 100_000,
        '{"kind": "log", "elements": []}',
    ):
        file.write_text(damaged)
        caplog.clear()
        reader = TableOfContents(tmp_path)
        assert [reader.fetch(7), reader.fetch(7)] == [None, None]
        assert caplog.text.count("requested from the drone again") == 1, (
            "once, though links look again and again"
        )


def test_bytes_that_are_no_text_are_asked_for_again(tmp_path) -> None:
    for content in (b"", b"\xff\xfe" * 50, bytes(400)):
        (tmp_path / "00000007.json").write_bytes(content)
        assert TableOfContents(tmp_path).fetch(7) is None


def test_without_a_home_they_are_known_to_this_process_and_one_line_says_so(
    monkeypatch, caplog
) -> None:
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pathlib.Path.home", no_home)
    assert contents.tables_folder() is None
    table = TableOfContents(contents.tables_folder())
    for crc in (7, 8):
        assert table.fetch(crc) is None
        table.insert(crc, told := log_table())
        assert table.fetch(crc) is told
    assert (
        caplog.text.count(
            "cache: tables of contents: no home folder: they are not stored"
        )
        == 1
    )


def test_a_full_disk_is_told_once(tmp_path, monkeypatch, caplog) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(contents.os, "replace", full)
    table = TableOfContents(tmp_path)
    for crc in (7, 8):
        table.insert(crc, log_table())
    assert caplog.text.count("No space left on device") == 1
