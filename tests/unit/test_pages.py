"""What the README files of rooms show works: commands, code, links into pages; and they read easily."""

import ast
import re
import runpy
import tomllib
from pathlib import Path
from typing import Any

import pytest
import typer
from prose_rules import PEOPLE, POINTERS
from reference.pages import BEGIN, END

from crazychoir.cli.compute import bench
from crazychoir.cli.main import app
from crazychoir.config.swarm_config import SwarmConfig

REPOSITORY = Path(__file__).resolve().parents[2]
ROOM_PAGES = sorted((REPOSITORY / "crazychoir").glob("**/README.md"))
PAGES = [
    REPOSITORY / "CONTRIBUTING.md",
    *ROOM_PAGES,
    REPOSITORY / "crazychoir" / "api" / "ENVIRONMENTS.md",
    *sorted((REPOSITORY / "deploy").glob("*.md")),
]
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)
EXAMPLES = {
    "crazychoir/bus/README.md": "bus_example.py",
    "crazychoir/optimization/algorithms/compressed/README.md": "few_bytes.py",
    "crazychoir/optimization/algorithms/exact_gradient/README.md": "sparse.py",
    "crazychoir/optimization/algorithms/resilient/README.md": "liars.py",
    "crazychoir/optimization/algorithms/stochastic/README.md": "samples.py",
    "crazychoir/optimization/algorithms/time_varying/README.md": "moving.py",
    "crazychoir/team/README.md": "team_example.py",
}
MOST_WORDS = 90  # a paragraph
CODE = ("crazychoir", "agents", "deploy", "tests")
"""Folders with code."""
NAME = re.compile(r"\b(?:[A-Z][A-Z_0-9]+|[A-Z]+[a-z]\w*|[a-z]\w*_\w+)\b")
"""A constant, a class, or a function of two words."""
NAMES_OF_OTHERS = {
    "DynamicUser",  # systemd
    "Estimator",  # the CrazyChoir paper
    "MY_TOPIC",  # the reader's
    "own_address",
}
"""Names on pages that no code has."""

every_page = pytest.mark.parametrize(
    "page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY))
)


def blocks(page: Path, language: str) -> list[str]:
    """Return the code blocks of a page in a language."""
    found = FENCE.findall(page.read_text())
    return [code for _, name, code in found if name == language]


def prose(text: str) -> str:
    """Return a page without code and without generated tables."""
    written = re.sub(f"{BEGIN}.*?{END}", "", text, flags=re.DOTALL)
    return re.sub(r"`[^`\n]*`", "`code`", FENCE.sub("", written))


def commands(page: Path) -> list[list[str]]:
    """Return the words of each `crazychoir ...` in the shell blocks of a page."""
    found = []
    for line in "".join(blocks(page, "sh")).splitlines():
        for part in re.split(r"&&|;|\|", line.partition(" #")[0]):
            match = re.search(r"\bcrazychoir [a-z].*", part)
            if match and "$" not in match[0] and "{" not in match[0]:
                found.append(match[0].replace("'", "").split()[1:])
    return found


def unknown_words(words: list[str]) -> list[str]:
    """Return the commands and options of a command line that do not exist."""
    command: Any = typer.main.get_command(bench.app if words[0] == "bench" else app)
    words = words[1:] if words[0] == "bench" else words
    while words and getattr(command, "commands", None):
        if words[0].startswith("-"):
            break
        if words[0] not in command.commands:
            return [words[0]]
        command = command.commands[words[0]]
        words = words[1:]
    known = {name for p in command.params for name in p.opts + p.secondary_opts}
    options = [word.partition("=")[0] for word in words if word.startswith("--")]
    return [option for option in options if option not in known]


def anchors(text: str) -> set[str]:
    """Return the anchors of the headings of a page, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", text), re.MULTILINE)
    return {
        re.sub(r"[^a-z0-9_ -]", "", heading.lower()).replace(" ", "-")
        for heading in headings
    }


def long_paragraphs(text: str) -> list[str]:
    """Return the start of each paragraph and list item that is too long; tables may be longer."""
    parts = re.split(r"\n\s*\n|\n(?= *(?:-|\d+\.) )", prose(text))
    return [
        part[:60]
        for part in parts
        if not part.lstrip().startswith("|") and len(part.split()) > MOST_WORDS
    ]


@every_page
def test_commands_of_a_page_exist(page):
    wrong = [(words, unknown_words(words)) for words in commands(page)]
    assert [case for case in wrong if case[1]] == []


def test_unknown_commands_and_options_are_found():
    assert unknown_words(["rum", "figure"]) == ["rum"]
    assert unknown_words(["keys", "revive", "a"]) == ["revive"]
    assert unknown_words(["run", "figure", "--quick", "--fast"]) == ["--quick"]
    assert unknown_words(["bench", "flight", "--slow"]) == ["--slow"]
    assert unknown_words(["virtual", "fault", "2", "loss=0.3"]) == []


@every_page
def test_code_of_a_page_can_be_read(page):
    for code in blocks(page, "python"):
        compile(code, str(page), "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
    for code in blocks(page, "toml"):
        tomllib.loads(code)


@pytest.mark.parametrize("page", EXAMPLES)
def test_program_of_a_page_prints_what_the_page_says(page, tmp_path, capsys):
    text = (REPOSITORY / page).read_text()
    name = EXAMPLES[page]
    (code,) = re.findall(rf"<!-- {name} -->\n```python\n(.*?)```", text, re.DOTALL)
    (tmp_path / name).write_text(code)
    runpy.run_path(str(tmp_path / name))
    printed = capsys.readouterr().out.strip()
    if name != "team_example.py":
        assert f"It prints `{printed}`" in text
        return
    found = ast.literal_eval(printed)
    assert found == pytest.approx([2.5] * 6, abs=4e-9)
    (tmp_path / name).write_text(code.replace('"loss": 0.3', '"loss": 0.0'))
    runpy.run_path(str(tmp_path / name))
    assert ast.literal_eval(capsys.readouterr().out.strip()) == found


def test_the_swarm_file_of_the_page_is_a_swarm_file():
    first, *_ = blocks(REPOSITORY / "deploy" / "README.md", "toml")
    config = SwarmConfig.loads(first)
    assert config.ids == (0, 1, 2, 3)
    assert config.mission == "bearing_formation"


@pytest.fixture(scope="module")
def words_of_the_code() -> set[str]:
    """Return all words in the files of the repository that are no pages."""
    files = [file for folder in CODE for file in (REPOSITORY / folder).rglob("*.*")]
    own = [file for file in files if file.suffix in (".py", ".toml", ".js")]
    return {word for file in own for word in re.findall(r"\w+", file.read_text())}


def unknown_names(text: str, words: set[str]) -> list[str]:
    """Return the names in the inline code of a page that no code has; paths are not looked at."""
    written = FENCE.sub("", re.sub(f"{BEGIN}.*?{END}", "", text, flags=re.DOTALL))
    codes = [code for code in re.findall(r"`([^`\n]+)`", written) if ".py" not in code]
    found = {name for code in codes for name in NAME.findall(code)}
    return sorted(found - words - NAMES_OF_OTHERS)


@every_page
def test_names_on_a_page_are_those_of_the_code(page, words_of_the_code):
    assert unknown_names(page.read_text(), words_of_the_code) == []


def test_unknown_names_are_found():
    text = "`Rule` and `LIMITS` of `add_rule(x)`, `a/test_rule.py`\n```\nOther\n```\n"
    assert unknown_names(text, {"add_rule"}) == ["LIMITS", "Rule"]


@every_page
def test_links_into_a_page_lead_to_a_heading(page):
    text = FENCE.sub("", page.read_text())
    for path, anchor in re.findall(r"\]\(([^)\s#]*)#([^)\s]+)\)", text):
        target = page.parent / path if path else page
        assert anchor in anchors(target.read_text()), f"{path}#{anchor}"


@every_page
def test_a_page_is_in_plain_english(page):
    text = prose(page.read_text())
    assert [m[0] for rule in (PEOPLE, POINTERS) for m in rule.finditer(text)] == []


@every_page
def test_paragraphs_of_a_page_are_short(page):
    assert long_paragraphs(page.read_text()) == []


def test_a_long_paragraph_is_found():
    assert long_paragraphs("a " * MOST_WORDS) == []
    assert len(long_paragraphs("a " * (MOST_WORDS + 1))) == 1
    assert long_paragraphs("| " + "a " * (MOST_WORDS + 1)) == []
