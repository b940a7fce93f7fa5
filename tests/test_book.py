"""The book builds without a warning, can be searched, and leaves no public name out."""

import ast
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = ROOT / "notebooks"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
OUTPUT = Path(__file__).parent / "notebooks" / "output"
PAGES = ["index", "guide/adaptive", "gallery/figure_eight", "reference/steppers", "coming_from"]


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    if importlib.util.find_spec("sphinx") is None:
        pytest.skip("there is no Sphinx")
    folder = tmp_path_factory.mktemp("book")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", str(NOTEBOOKS), str(folder)]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr[-4000:]
    return folder


def test_every_public_name_stands_in_the_reference():
    stub = ast.parse((ROOT / "symsimpson/__init__.pyi").read_text("utf-8"))
    names = {a.asname for x in stub.body if isinstance(x, ast.ImportFrom) for a in x.names}
    pages = "".join(path.read_text("utf-8") for path in (NOTEBOOKS / "reference").glob("*.md"))
    told = set(re.findall(r"\.\. (?:auto)?(?:function|class|data|exception):: (\w+)", pages))
    assert names - {"systems"} == told


def test_the_readme_is_one_page():
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 150


def test_gallery_pages_are_short_and_described():
    nbformat = pytest.importorskip("nbformat")
    pages = sorted((NOTEBOOKS / "gallery").glob("*.ipynb"))
    assert len(pages) >= 17
    for path in pages:
        cells = nbformat.read(path, as_version=4).cells
        lines = sum(len(cell.source.splitlines()) for cell in cells)
        assert lines <= 60, path.name
        drawn = [c for c in cells if any("image/png" in str(o.get("data", {})) or
                 "text/html" in str(o.get("data", {})) for o in c.get("outputs", []))]  # fmt: skip
        described = [c for c in cells if "mystnb" in c.metadata]
        assert drawn, path.name
        assert described, path.name
        for cell in described:
            assert len(cell.metadata["mystnb"]["image"]["alt"]) > 30, path.name


@pytest.mark.slow
def test_it_builds_without_a_warning(book):
    assert len(list(book.rglob("*.html"))) > 50
    assert "constraint" in (book / "searchindex.js").read_text("utf-8")
    home = (book / "index.html").read_text("utf-8")
    assert "https://cdn" not in home


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
def test_a_person_reads_it(book):
    api = pytest.importorskip("playwright.sync_api")
    OUTPUT.mkdir(exist_ok=True)
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM,
            args=["--no-sandbox", "--allow-file-access-from-files", "--disable-gpu"],
        )
        page = browser.new_page(viewport={"width": 1300, "height": 1000})
        page.set_default_timeout(60_000)
        asked = []
        page.on("request", lambda request: asked.append(request.url))
        for name in PAGES:
            page.goto((book / f"{name}.html").as_uri())
            assert page.locator("h1").count() == 1
            page.screenshot(path=OUTPUT / f"book_{name.replace('/', '_')}.png")
        page.goto((book / "search.html").as_uri() + "?q=constraint")
        page.wait_for_selector("#search-results li a")
        assert page.locator("#search-results li a").count() > 5
        page.screenshot(path=OUTPUT / "book_search.png")
        page.goto((book / "gallery/figure_eight.html").as_uri())
        film = page.frame_locator("iframe").locator("img")
        film.wait_for()
        seen = set()
        for _ in range(100):
            seen.add(film.get_attribute("src"))
            page.wait_for_timeout(50)
        assert len(seen) > 4, "the film stands still"
        page.locator("iframe").first.scroll_into_view_if_needed()
        page.screenshot(path=OUTPUT / "book_film.png")
        browser.close()
    assert all(url.startswith(("file:", "data:", "blob:", "about:")) for url in asked)
