"""Pages of the site from outside `docs/`: mkdocs calls these functions while it builds.

README, changelog and the like stand in the repository's root, where people look for them, and the
notebook is run by the tests. Each is a page of the site, too, out of the same file; links lead to
the same places from there.
"""

import json
import posixpath
import re
from pathlib import Path
from typing import Final

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT: Final = Path(__file__).parents[1]
NOTEBOOK: Final = "docs/notebooks/first_ten_minutes.ipynb"
PAGES: Final = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "STYLE.md": "style.md",
    "SECURITY.md": "security.md",
    "CODE_OF_CONDUCT.md": "conduct.md",
    "LICENSE": "LICENSE",
    "NOTICE": "NOTICE",
    "CITATION.cff": "CITATION.cff",
    NOTEBOOK: "guides/first_ten_minutes.md",
}
"""Where each file of the repository is on the site."""
PLAY: Final = ROOT / "build/play"
"""The exported page of `sightline serve`, which `make docs` writes before."""

_LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)#\s]+)")


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages of files outside `docs/`, and the exported page."""
    for source, page in PAGES.items():
        if source == NOTEBOOK:
            text = notebook_text((ROOT / source).read_text())
            files.append(File.generated(config, page, content=text))
        else:
            files.append(File.generated(config, page, abs_src_path=str(ROOT / source)))
    if not (PLAY / "index.html").is_file():
        raise PluginError(f"{PLAY} holds no exported page; run `make docs`, which writes it")
    for path in sorted(PLAY.rglob("*")):
        if path.is_file():
            place = f"play/{path.relative_to(PLAY).as_posix()}"
            files.append(File.generated(config, place, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links between files of the repository into links between pages."""
    del config, files
    here = page.file.src_uri
    source = {page: source for source, page in PAGES.items()}.get(here, f"docs/{here}")

    def to_page(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link[1]))
        target = PAGES.get(target, target.removeprefix("docs/"))
        return posixpath.relpath(target, posixpath.dirname(here) or ".")

    return _LINK.sub(to_page, markdown)


def notebook_text(notebook: str) -> str:
    """A notebook as Markdown, without what its cells have printed."""
    parts = []
    for cell in json.loads(notebook)["cells"]:
        text = "".join(cell["source"])
        parts.append(f"```python\n{text}\n```" if cell["cell_type"] == "code" else text)
    return "\n\n".join(parts) + "\n"
