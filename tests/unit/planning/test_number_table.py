import itertools

import numpy as np
import pytest

from crazychoir.planning.number_table import (
    TableError,
    parse_table,
    read_table,
    read_table_text,
)

COLUMNS = ("t", "x", "y")
PLAIN = [[0.0, 1.5, -2.0], [0.5, 2.5, 1e-3]]


def numbers(table):
    return np.column_stack([table[name] for name in COLUMNS]).tolist()


COMMENTS = ("", "# flight of 3 May, v 0.5\n", "\n  \n#\n,,\n;;\n", "# Größe, a;b\n\n")
ENDS = ("\n", "\r\n", "\r")
SEPARATORS = (",", ", ", ";", "\t", " ", "   ")
HEADS = (
    "t{0}x{0}y",
    "T{0}X{0}Y",
    "# t{0}x{0}y",
    "#t{0}x{0}y",
    "y{0}t{0}x",
    "time{0}x[m]{0}y(m)",
    "t{0}x{0}y # s, m",
)


@pytest.mark.parametrize(
    ("separator", "decimal"),
    [*((one, ".") for one in SEPARATORS), (";", ","), ("\t", ",")],
)
@pytest.mark.parametrize("head", HEADS)
def test_tables_of_all_these_dialects_say_the_same(tmp_path, head, separator, decimal):
    order = [1, 2, 0] if head.startswith("y") else [0, 1, 2]
    order = [order.index(k) for k in range(3)]
    for comment, end, mark, tail in itertools.product(
        COMMENTS, ENDS, ("", "\ufeff"), ("", separator.strip(" "))
    ):
        rows = [
            separator.join(f"{row[k]:g}" for k in order).replace(".", decimal) + tail
            for row in PLAIN
        ]
        lines = [
            head.format(separator) + tail,
            "",
            f"{rows[0]} # here",
            "# there",
            rows[1],
            "",
        ]
        text = mark + comment + "\n".join(lines)
        path = tmp_path / "ä.csv"
        path.write_bytes(text.replace("\n", end).encode())
        table = read_table(path, COLUMNS)
        assert numbers(table) == PLAIN, text
        first = text.count("\n", 0, text.index(rows[0])) + 1
        assert table["line"].tolist() == [first, first + 2], text


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1", "cp1252"]
)
def test_the_encoding_of_comments_does_not_matter(tmp_path, encoding):
    path = tmp_path / "a.csv"
    path.write_bytes("# Höhe\nt,x,y\n0,1.5,-2\n0.5,2.5,0.001\n".encode(encoding))
    assert numbers(read_table(path, COLUMNS)) == PLAIN


def test_a_line_that_says_the_separator_is_followed():
    assert (
        numbers(
            parse_table('"sep=;"\nt;x;y\n0;1,5;-2\n0,5;2,5;0,001\n', "a.csv", COLUMNS)
        )
        == PLAIN
    )


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("0,1,2\n", "line 1: found numbers without names.*t, x, y"),
        ("# by hand\n0,1,2\n", "line 2: found numbers without names"),
        ("# t,x\n0,1\n", "line 2: found numbers without names"),
        ("# nothing\n", "empty file"),
        ("# a\nt,x,y\n# b\n", "no row"),
        ("t,x,y\n0,1,5,2\n", "line 2: found 4 columns; allowed: 3.*semicolons"),
        (
            "t;x;y\n0;1.5;2\n1;1,234;2\n",
            r"line 3, column 2 \(x\): found '1,234'; allowed: a point in each",
        ),
        ("t;x;y\n0;1.234,5;2\n", r"line 2, column 2 \(x\): found '1.234,5'"),
        ("t,x,y\n0,1_000,2\n", r"line 2, column 2 \(x\): found '1_000'"),
        ("t,x,y\n0,\u0661,2\n", r"line 2, column 2 \(x\)"),
        ("t,x,y\n0,,2\n", r"line 2, column 2 \(x\): found ''"),
        ("t,x,y\n0,inf,2\n", r"line 2, column 2 \(x\): found 'inf'"),
        (
            "t,x [mm],y\n0,1,2\n",
            r"line 1, column 2: found 'x \[mm\]'; allowed: units: s, m, rad",
        ),
        ("t,x,x [m]\n0,1,2\n", "line 1, column 3: found 'x'.*once"),
        ("\n\nt,x,z\n0,1,2\n", "line 3, column 3: found 'z'"),
        ("t,x,y\n%0,1,2\n", r"line 2, column 1 \(t\): found '%0'"),
    ],
)
def test_what_has_no_one_meaning_is_refused_with_its_line(text, complaint):
    with pytest.raises(TableError, match=f"^a.csv.*{complaint}"):
        parse_table(text, "a.csv", COLUMNS)


def test_a_missing_file_of_the_package_is_said_to_be_there(tmp_path):
    with pytest.raises(TableError, match=r"comes with the package: .*figure8\.csv"):
        read_table_text(tmp_path / "figure8.csv")
    with pytest.raises(TableError) as caught:
        read_table_text(tmp_path / "mine.csv")
    assert "comes with" not in str(caught.value)
