"""The pages of the site: the README files of the repository, corrected for mkdocs.

Their links are written for GitHub. The site has the same tree of pages, so a link from page to page
stays; a link to another file leads to GitHub. The text of a list item is indented by four spaces,
as mkdocs asks, not by two or three.
"""

import re
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from posixpath import dirname, join, normpath, relpath

REPOSITORY = Path(__file__).resolve().parents[1]
FRONT_PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")
FOLDERS = ("agents", "crazychoir", "deploy")
"""Folders with pages and pictures."""
FILES_ON_GITHUB = "https://github.com/crazychoir/crazychoir/blob/main/"
FOLDERS_ON_GITHUB = "https://github.com/crazychoir/crazychoir/tree/main/"
PICTURES_ON_GITHUB = "https://raw.githubusercontent.com/crazychoir/crazychoir/main/"
HERE_ON_GITHUB = (FILES_ON_GITHUB, FOLDERS_ON_GITHUB, PICTURES_ON_GITHUB)
CODE = re.compile(r"^( *)(```+).*?^\1\2 *$|(`+).+?\3", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")
NAMED_BLOCK = re.compile(r"^<!-- (\S+\.\w+) -->\n```(\w+)$", re.MULTILINE)
OTHER_SITE = re.compile(r"[a-z]+:")
LIST_ITEM = re.compile(r"(\d+\. |- )")
INDENT_OF_MKDOCS = 4  # spaces before the text of a list item


def pages() -> list[str]:
    """Return the paths of all pages in the repository."""
    return [*FRONT_PAGES, *_files("*.md")]


def pictures() -> list[str]:
    """Return the paths of all pictures in the repository."""
    return list(_files("*.png"))


def _files(pattern: str) -> Iterator[str]:
    """Yield the paths of the files below FOLDERS; a link to a folder is not followed."""
    for folder in FOLDERS:
        for file in sorted((REPOSITORY / folder).rglob(pattern)):
            if file.resolve() == file:
                yield file.relative_to(REPOSITORY).as_posix()


def for_the_site(
    text: str, page: str, files: Collection[str], report: Callable[[str], None]
) -> str:
    """Return a page of the repository as a page of the site.

    text: the page in Markdown
    page: its path in the repository
    files: paths of the pages and pictures of the site
    report: called with each link that leads nowhere
    """

    def corrected(link: re.Match[str]) -> str:
        try:
            return f"]({site_link(link[1], page, files)})"
        except FileNotFoundError:
            report(f"{page}: the link {link[1]} leads to no file")
            return link[0]

    parts = []
    end = 0
    for code in CODE.finditer(text):
        parts += [LINK.sub(corrected, text[end : code.start()]), code[0]]
        end = code.end()
    parts.append(LINK.sub(corrected, text[end:]))
    named = NAMED_BLOCK.sub(r'```\2 title="\1"', "".join(parts))
    return _with_wide_lists(named)


def _with_wide_lists(text: str) -> str:
    """Return a page on which what belongs to a list item is indented as mkdocs asks."""
    lines = []
    missing = 0
    is_code = False
    for line in text.splitlines(keepends=True):
        item = LIST_ITEM.match(line)
        if line.startswith("```"):
            is_code = not is_code
            missing = 0
        elif item and not is_code:
            missing = INDENT_OF_MKDOCS - len(item[0])
        elif line.startswith(" "):
            line = " " * missing + line
        elif line.strip():
            missing = 0
        lines.append(line)
    return "".join(lines)


def site_link(link: str, page: str, files: Collection[str]) -> str:
    """Return a link of a page as it must stand on the site.

    Raises FileNotFoundError if the link leads to no file of the repository.
    """
    path, anchor = _path_in_the_repository(link, page)
    if path is None:
        return link
    if f"{path}/README.md" in files:
        path = f"{path}/README.md"
    if path in files:
        return relpath(path, dirname(page) or ".") + anchor
    target = REPOSITORY / path
    if not target.exists():
        raise FileNotFoundError(path)
    return (FOLDERS_ON_GITHUB if target.is_dir() else FILES_ON_GITHUB) + path + anchor


def _path_in_the_repository(link: str, page: str) -> tuple[str | None, str]:
    """Return the path that a link leads to, and its anchor; None for another site or this page."""
    target, mark, anchor = link.partition("#")
    for prefix in HERE_ON_GITHUB:
        if target.startswith(prefix):
            return normpath(target.removeprefix(prefix)), mark + anchor
    if not target or OTHER_SITE.match(target):
        return None, ""
    return normpath(join(dirname(page), target)), mark + anchor


def heading_id(heading: str, separator: str = "-") -> str:
    """Return the anchor of a heading, as GitHub makes it.

    separator: what stands for a space
    """
    text = re.sub(r"<[^>]*>", "", heading).strip().lower()
    return re.sub(r"[^\w\- ]", "", text).replace(" ", separator)
