"""The book builds without a warning, can be searched, and leaves no public name out."""

import ast
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.places import ROOT

NOTEBOOKS = ROOT / "notebooks"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
OUTPUT = Path(__file__).parent / "output"
PAGES = ["index", "guide/adaptive", "gallery/figure_eight", "reference/stepper", "coming_from"]


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
    index = (NOTEBOOKS / "gallery/index.md").read_text("utf-8")
    assert len(pages) >= 17
    for path in pages:
        cells = nbformat.read(path, as_version=4).cells
        lines = sum(len(cell.source.splitlines()) for cell in cells)
        assert lines <= 60, path.name
        assert (path.parent / "thumbnails" / f"{path.stem}.png").stat().st_size > 2000, path.name
        assert f"thumbnails/{path.stem}.png" in index, path.name
        drawn = [
            c
            for c in cells
            if any(
                "image/png" in str(o.get("data", {})) or "text/html" in str(o.get("data", {}))
                for o in c.get("outputs", [])
            )
        ]
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


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        pytest.skip("there is no Chromium")
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(
            executable_path=CHROMIUM,
            args=["--no-sandbox", "--allow-file-access-from-files", "--disable-gpu"],
        )
        yield opened
        opened.close()


#: How wide a page is, and how many of its texts are cut at their right edge.
MEASURE = """() => [
    document.documentElement.scrollWidth,
    [...document.querySelectorAll("article pre")].filter(
        x => x.scrollWidth > x.clientWidth + 1).length,
    [...document.querySelectorAll("article .cell_output")].filter(
        x => x.querySelector("iframe, pre") && x.scrollWidth > x.clientWidth + 1).length,
]"""


#: Two frames later a page is drawn as wide as its window.
DRAWN = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"


@pytest.mark.slow
def test_nothing_is_wider_than_the_screen(book, browser):
    """Each page is loaded once, and made as narrow as a telephone."""
    page = browser.new_page()
    page.set_default_timeout(60_000)
    pages = [x for x in sorted(book.rglob("*.html")) if x.relative_to(book).parts[0][0] != "_"]
    assert len(pages) > 60
    for path in pages:
        page.set_viewport_size({"width": 1280, "height": 900})
        page.goto(path.as_uri())
        for width in (1280, 390):
            page.set_viewport_size({"width": width, "height": 900})
            page.evaluate(DRAWN)
            assert page.evaluate(MEASURE) == [width, 0, 0], (path.name, width)
    page.close()


#: What people look for, and the page that should be among the first six.
SOUGHT = {
    "step size": "guide/choose",
    "energy drift": "how_do_i",
    "tolerance": "how_do_i",
    "initial conditions": "how_do_i",
    "robot": "how_do_i",
    "quadrotor": "how_do_i",
    "contact": "how_do_i",
    "save": "how_do_i",
    "plot": "how_do_i",
    "Poincare": "guide/run",
    "licence": "index",
    "license": "index",
    "export pandas": "guide/files",
    "film": "guide/run",
}


@pytest.mark.slow
def test_search_finds_what_people_look_for(book, browser):
    page = browser.new_page()
    page.set_default_timeout(60_000)
    for words, wanted in SOUGHT.items():
        page.goto((book / "search.html").as_uri() + "?q=" + words.replace(" ", "+"))
        page.wait_for_selector("#search-results li a")
        page.wait_for_timeout(1500)
        links = page.locator("#search-results li > a").all()[:6]
        found = [(link.get_attribute("href") or "").split(".html")[0] for link in links]
        assert wanted in found, (words, found)
    page.close()


@pytest.mark.slow
def test_a_person_reads_it(book, browser):
    OUTPUT.mkdir(exist_ok=True)
    page = browser.new_page(viewport={"width": 1300, "height": 1000})
    page.set_default_timeout(60_000)
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    for name in PAGES:
        page.goto((book / f"{name}.html").as_uri())
        assert page.locator("h1").count() == 1
        page.screenshot(path=OUTPUT / f"book_{name.replace('/', '_')}.png")
    page.goto((book / "gallery/figure_eight.html").as_uri())
    assert page.locator("article a.download").count() == 1
    assert page.locator("article button.copybtn").count() > 2
    film = page.frame_locator("iframe").locator("img")
    film.wait_for()
    seen = set()
    for _ in range(100):
        seen.add(film.get_attribute("src"))
        page.wait_for_timeout(50)
    assert len(seen) > 4, "the film stands still"
    page.locator("iframe").first.scroll_into_view_if_needed()
    page.screenshot(path=OUTPUT / "book_film.png")
    page.close()
    assert all(url.startswith(("file:", "data:", "blob:", "about:")) for url in asked)
