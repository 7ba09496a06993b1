"""Hooks of mkdocs: the pages of the site are the README files of the repository, and the API."""

from typing import Any

import api_pages
import site_links
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import get_plugin_logger
from mkdocs.structure.files import File, Files

log = get_plugin_logger("site")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Give headings the anchors that GitHub gives them: links into pages use these."""
    config.mdx_configs["toc"]["slugify"] = site_links.heading_id
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages and pictures of the repository, and the pages of the API."""
    for path in (*site_links.pages(), *site_links.pictures()):
        file = File.generated(
            config, path, abs_src_path=str(site_links.REPOSITORY / path)
        )
        file.edit_uri = path
        files.append(file)
    for path, text in api_pages.texts().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, files: Files, **_: Any) -> str:
    """Correct the links of a page; a link that leads nowhere is a warning, which ends a strict build."""
    path = page.file.src_uri
    if path in api_pages.PAGES or path == api_pages.INDEX:
        return markdown
    return site_links.for_the_site(markdown, path, files.src_uris, log.warning)
