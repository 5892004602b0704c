"""The site is built without a warning, opens from disk, asks nobody else, and can be searched."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import globule as gb
import pytest
from waiting import PATIENCE

pytest.importorskip("sphinx", reason="pip install 'globule[docs]'")
pytest.importorskip("myst_parser")
pytest.importorskip("pydata_sphinx_theme")
pytest.importorskip("nbclient")

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "site"))

import pages as site_pages  # noqa: E402

BROWSERS = True  # conftest.py: what these tests wait for has a limit of its own
PAGES = (
    "index.html",
    "start/first-image.html",
    "reference/python/scene.html",
    "reference/commands/render.html",
    "reference/headers/scene.html",
    "understand/conventions.html",
    "gallery.html",
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the built site; a warning of the build is an error."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "docs/site", str(folder)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(Path(gb.__file__).parents[1])},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


class Page(HTMLParser):
    """What a page links to and loads, and its anchors."""

    def __init__(self, path: Path):
        super().__init__()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.anchors: set[str] = set()
        self.images = 0
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.anchors |= {found[key] for key in ("id", "name") if found.get(key)}
        self.images += tag == "img"
        if tag == "a" and found.get("href"):
            self.links.add(found["href"])
        elif tag in ("script", "img", "link", "iframe") and found.get("rel") != "canonical":
            self.loaded |= {found[key] for key in ("src", "href") if found.get(key)}


@pytest.fixture(scope="module")
def pages(site):
    return {path: Page(path) for path in site.rglob("*.html") if "_static" not in path.parts}


def test_every_link_leads_to_a_page_and_an_anchor(site, pages):
    broken = []
    for path, page in pages.items():
        for link in page.links | page.loaded:
            name, _, anchor = link.partition("#")
            if re.match(r"[a-z]+:", link):
                continue
            name = name.partition("?")[0]
            target = (path.parent / unquote(name)).resolve() if name else path
            known = pages.get(target)
            top = anchor in ("", "__top")
            if not target.exists() or (known and not top and unquote(anchor) not in known.anchors):
                broken.append(f"{path.relative_to(site)}: {link}")
    assert broken == []


def test_nothing_is_loaded_from_elsewhere(pages):
    loaded = {link for page in pages.values() for link in page.loaded}
    assert [link for link in loaded if re.match(r"(?:[a-z]+:)?//", link)] == []


def test_every_page_of_docs_is_there(site):
    for path in (ROOT / "docs").rglob("*.md"):
        assert (site / path.relative_to(ROOT / "docs").with_suffix(".html")).exists(), path
    assert (site / "changes.html").exists()


def test_tutorials_show_their_images(site, pages):
    for name in ("first-image", "first-volume", "first-simulation"):
        page = pages[site / "start" / f"{name}.html"]
        assert page.images >= 3
        (notebook,) = (link for link in page.links if link.endswith(f"{name}.ipynb"))
        assert (site / "start" / notebook).stat().st_size > 10_000


@pytest.fixture
def opened(chromium, site):
    """A browser window, and the addresses that it asked for."""
    page = chromium.new_page(viewport={"width": 1300, "height": 900})
    asked: list[str] = []
    wrong: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    yield page, asked
    page.close()
    assert wrong == []


@pytest.mark.browser
def test_pages_from_disk_ask_nobody(site, opened):
    page, asked = opened
    for name in PAGES:
        page.goto((site / name).as_uri())
        page.wait_for_load_state("networkidle", timeout=1e3 * PATIENCE)
        assert page.locator("h1").first.inner_text().strip()
    assert len(asked) > len(PAGES)
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


@pytest.mark.browser
def test_search_from_disk(site, opened):
    page, asked = opened
    page.goto((site / "index.html").as_uri())
    page.keyboard.press("Control+k")
    page.keyboard.type("iso-value\n")
    page.locator("#search-results a").first.wait_for(timeout=1e3 * PATIENCE)
    links = page.locator("#search-results a").evaluate_all("all => all.map(a => a.href)")
    assert len(links) > 3
    assert all(link.startswith("file:") for link in links)
    found = {Path(re.sub(r"[?#].*", "", link).removeprefix("file://")) for link in links}
    texts = [page.read_text().lower() for page in found]
    assert all("iso" in text and "value" in text for text in texts)  # its two parts
    assert any("iso-value" in text for text in texts)
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


def test_a_broken_link_stops_the_build(tmp_path, capsys):
    from sphinx.cmd.build import main

    (tmp_path / "index.md").write_text("# Home\n\n[nowhere](missing.md)\n")
    command = ["-q", "-W", "-c", str(ROOT / "docs" / "site"), str(tmp_path), str(tmp_path / "out")]
    assert main(command) != 0
    assert "missing.md" in capsys.readouterr().err


def test_a_broken_link_of_the_readme_stops_the_build(tmp_path):
    (tmp_path / "README.md").write_text("[code](https://x.org) and [nowhere](docs/missing.md)\n")
    with pytest.raises(FileNotFoundError, match=r"README\.md: .* docs/missing\.md"):
        site_pages.at_docs(tmp_path / "README.md")
