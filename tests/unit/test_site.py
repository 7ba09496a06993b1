"""The site that `make docs` builds: its pages, their links, and the documentation of the API."""

import re
import sys
from types import SimpleNamespace

import api_pages
import pytest
import site_links
from pages import FRONT_PAGE, PAGES

import crazychoir

FILES = [*site_links.pages(), *site_links.pictures()]
BEARING = "agents/pictures/bearing_formation.png"


@pytest.fixture(scope="module")
def as_markdown():
    """Return the function that makes Markdown of a docstring; griffe need not be installed."""
    before = sys.modules.get("griffe")
    sys.modules["griffe"] = SimpleNamespace(Extension=object, Object=object)
    try:
        from docstrings import as_markdown
    finally:
        if before is None:
            del sys.modules["griffe"]
        else:
            sys.modules["griffe"] = before
    return as_markdown


def on_site(text: str, page: str = "agents/README.md") -> str:
    return site_links.for_the_site(text, page, FILES, pytest.fail)


def test_every_page_is_in_the_navigation_once(repository):
    navigation = (repository / "mkdocs.yml").read_text().split("\nnav:\n")[1]
    found = re.findall(r": (\S+\.md)$", navigation, re.MULTILINE)
    assert sorted(found) == sorted([*site_links.pages(), *api_pages.texts()])


def test_every_page_of_a_room_is_a_page_of_the_site():
    assert set(PAGES) <= set(site_links.pages())


@pytest.mark.parametrize("page", site_links.pages())
def test_the_links_of_a_page_lead_somewhere(repository, page):
    on_site((repository / page).read_text(), page)


@pytest.mark.parametrize(
    ("page", "link", "expected"),
    [
        ("agents/README.md", "../deploy/README.md", "../deploy/README.md"),
        ("agents/README.md", "../deploy/README.md#a", "../deploy/README.md#a"),
        ("agents/README.md", "#hooks", "#hooks"),
        ("agents/README.md", "https://zenoh.io", "https://zenoh.io"),
        ("agents/README.md", "pictures/bearing_formation.png", None),
        ("crazychoir/README.md", "safety", "safety/README.md"),
        (
            "crazychoir/README.md",
            "types.py",
            f"{site_links.FILES_ON_GITHUB}crazychoir/types.py",
        ),
        (
            "crazychoir/README.md",
            "runtime",
            f"{site_links.FOLDERS_ON_GITHUB}crazychoir/runtime",
        ),
        (
            FRONT_PAGE,
            f"{site_links.FILES_ON_GITHUB}agents/README.md#hooks",
            "agents/README.md#hooks",
        ),
        (FRONT_PAGE, f"{site_links.PICTURES_ON_GITHUB}{BEARING}", BEARING),
        (
            FRONT_PAGE,
            f"{site_links.FILES_ON_GITHUB}LICENSE",
            f"{site_links.FILES_ON_GITHUB}LICENSE",
        ),
    ],
)
def test_a_link_leads_to_a_page_of_the_site_or_to_github(page, link, expected):
    found = site_links.site_link(link, page, FILES)
    assert found == (link if expected is None else expected)


def test_a_link_that_leads_nowhere_is_reported():
    reported: list[str] = []
    text = "[a](none.md), [b](README.md)"
    found = site_links.for_the_site(text, "agents/README.md", FILES, reported.append)
    assert found == text
    assert reported == ["agents/README.md: the link none.md leads to no file"]


def test_links_in_code_are_left_alone():
    text = "`[a](none)` [b](README.md)\n\n```\n[c](none)\n```\n"
    assert on_site(text) == text


def test_a_program_shows_the_name_of_its_file():
    assert on_site("<!-- my_law.py -->\n```python\nx = 1\n```\n") == (
        '```python title="my_law.py"\nx = 1\n```\n'
    )


def test_what_belongs_to_a_list_item_is_indented_by_four():
    text = "1. One:\n\n   ```sh\n   ls\n   ```\n\n- Two\n  lines\n\nEnd\n  here\n"
    assert on_site(text) == (
        "1. One:\n\n    ```sh\n    ls\n    ```\n\n- Two\n    lines\n\nEnd\n  here\n"
    )


def test_lists_in_code_keep_their_indentation():
    text = "```\n- one\n  more\n```\n"
    assert on_site(text) == text


@pytest.mark.parametrize(
    ("heading", "anchor"),
    [
        ("Status, citing, licence", "status-citing-licence"),
        ("Time - and space", "time---and-space"),
        ("<code>[[drones]]</code>", "drones"),
        (
            "<code>crazychoir mocap set_origin FILE</code>",
            "crazychoir-mocap-set_origin-file",
        ),
    ],
)
def test_a_heading_has_the_anchor_that_github_gives_it(heading, anchor):
    assert site_links.heading_id(heading) == anchor


def test_the_index_of_the_api_has_every_public_name():
    index = api_pages.texts()[api_pages.INDEX]
    assert re.findall(r"^\| \[`(\w+)`\]", index, re.MULTILINE) == sorted(
        crazychoir.__all__
    )


def test_every_public_name_has_its_documentation_on_a_page():
    texts = api_pages.texts()
    targets = re.findall(r"\]\[([\w.]+)\]", texts.pop(api_pages.INDEX))
    for target in targets:
        module, _, name = target.rpartition(".")
        shown = rf"::: {re.escape(module)}\n    options:\n      members:(\n +- \w+)*\n +- {name}\n"
        assert any(re.search(shown, text) for text in texts.values()), target


def test_every_algorithm_is_on_its_page(repository):
    text = api_pages.texts()["api/algorithms.md"]
    folder = repository / "crazychoir" / "optimization" / "algorithms"
    for file in folder.rglob("[!_]*.py"):
        module = ".".join(file.relative_to(repository).with_suffix("").parts)
        assert f"::: {module}\n" in text


def test_a_name_that_a_module_does_not_define_is_refused(monkeypatch):
    row = ("Types", "States.", ("crazychoir.types:State,Attitude",))
    monkeypatch.setattr(api_pages, "PAGES", {"api/types.md": row})
    with pytest.raises(ValueError, match=r"types\.py does not define \['Attitude'\]"):
        api_pages.texts()


def test_arguments_and_errors_of_a_docstring_stand_on_lines_of_their_own(as_markdown):
    text = """Return the mean.

    x, y: (n,) m,
        world
    rate: Hz
    Raises ConfigError if n = 0.
    Source: Boyd 2011.
    """
    assert as_markdown(text) == (
        "Return the mean.\n\n"
        "- `x, y`: (n,) m, world\n- `rate`: Hz\n\n"
        "Raises ConfigError if n = 0.\n\nSource: Boyd 2011."
    )


def test_an_equation_of_a_docstring_keeps_its_layout(as_markdown):
    text = """Project.

        P = I - d d^T
          = P P

    P is symmetric.
    """
    assert as_markdown(text) == (
        "Project.\n\n```text\nP = I - d d^T\n  = P P\n```\n\nP is symmetric."
    )


def test_only_code_is_marked_in_a_docstring(as_markdown):
    assert as_markdown("Take *all* of x_i[j] and `a_b[*]`.") == (
        "Take \\*all\\* of x\\_i\\[j\\] and `a_b[*]`."
    )


def test_an_example_of_a_docstring_is_a_block_of_code(as_markdown):
    assert as_markdown("Add.\n\n>>> 1 + 1\n2") == "Add.\n\n```pycon\n>>> 1 + 1\n2\n```"
