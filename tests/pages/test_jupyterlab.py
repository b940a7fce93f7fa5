"""Notebooks as a person sees them: JupyterLab in a browser, run, shown, and the film playing.

Skipped where there is no JupyterLab, playwright or Chromium; screenshots go to ``output/``.
"""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest
from support.places import NOTEBOOKS

OUTPUT = Path(__file__).parent / "output"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
#: However slow the machine; in milliseconds.
MINUTES = 10 * 60_000
SETTINGS = {  # cells out of sight are drawn too
    "@jupyterlab/notebook-extension/tracker.jupyterlab-settings": {"windowingMode": "none"},
    "@jupyterlab/apputils-extension/notification.jupyterlab-settings": {
        "fetchNews": "false",
        "checkForUpdates": False,
    },
}

pytest.importorskip("jupyterlab")
api = pytest.importorskip("playwright.sync_api")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")]


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """The address of a JupyterLab whose folder holds the notebooks."""
    folder = tmp_path_factory.mktemp("lab")
    for name, content in SETTINGS.items():
        path = folder / "settings" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content))
    for path in NOTEBOOKS.glob("*.ipynb"):
        shutil.copy(path, folder)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [
        sys.executable,
        "-m",
        "jupyterlab",
        "--no-browser",
        "--allow-root",
        f"--port={port}",
        "--ServerApp.port_retries=0",
        "--IdentityProvider.token=",
        f"--ServerApp.root_dir={folder}",
        "--LabApp.expose_app_in_browser=True",
    ]
    environment = os.environ | {
        "JUPYTERLAB_SETTINGS_DIR": str(folder / "settings"),
        "JUPYTERLAB_WORKSPACES_DIR": str(folder / "workspaces"),
        "TQDM_DISABLE": "1",
    }
    log = (folder / "log").open("w")
    server = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
    address = f"http://127.0.0.1:{port}"
    try:
        while server.poll() is None:
            try:
                urllib.request.urlopen(f"{address}/api", timeout=5).close()
                break
            except OSError:
                time.sleep(0.5)
        yield address
    finally:
        server.terminate()
        try:
            server.wait(30)
        except subprocess.TimeoutExpired:
            server.kill()
        log.close()


@pytest.fixture(scope="module")
def browser():
    with api.sync_playwright() as playwright:
        options = ["--no-sandbox", "--enable-unsafe-swiftshader"]
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        yield found
        found.close()


def run_all(browser, lab, name):
    """Open a notebook, clear it, run it, and give the page when it is done."""
    page = browser.new_page(viewport={"width": 1300, "height": 1000})
    page.set_default_timeout(MINUTES)
    # nothing but the server of this test is to be reached
    page.route(lambda url: not url.startswith((lab, "data:", "blob:")), lambda route: route.abort())
    page.goto(f"{lab}/lab/tree/{name}.ipynb?reset")
    page.wait_for_selector(".jp-Notebook .jp-CodeCell")
    page.wait_for_function(
        "window.jupyterapp.shell.currentWidget?.sessionContext?.session?.kernel?.status === 'idle'"
    )
    for command in ("notebook:clear-all-cell-outputs", "notebook:run-all-cells"):
        page.evaluate(f"window.jupyterapp.commands.execute('{command}')")
    prompts = ".jp-CodeCell .jp-InputPrompt"
    page.wait_for_function(
        f"[...document.querySelectorAll('{prompts}')].every(x => /\\[\\d+\\]/.test(x.innerText))"
    )
    assert page.locator("[data-mime-type='application/vnd.jupyter.error']").count() == 0
    OUTPUT.mkdir(exist_ok=True)
    return page


def shoot(page, locator, name):
    locator.scroll_into_view_if_needed()
    page.wait_for_timeout(500)
    path = OUTPUT / f"{name}.png"
    page.screenshot(path=path)
    assert path.stat().st_size > 20_000


def test_a_first_notebook_shows_its_equations_and_figure(browser, lab):
    page = run_all(browser, lab, "01_define_a_system")
    page.wait_for_selector(".jp-OutputArea mjx-container")
    figure = page.locator(".jp-OutputArea img").first
    assert figure.bounding_box()["width"] > 300
    shoot(page, page.locator(".jp-OutputArea mjx-container").first, "01_equations")
    shoot(page, figure, "01_figure")


def test_the_last_notebook_shows_its_tables_and_plays_its_film(browser, lab):
    page = run_all(browser, lab, "10_from_lagrangian_to_figure")
    tables = page.locator(".jp-OutputArea table")
    assert tables.count() >= 4
    assert page.locator(".jp-OutputArea svg polyline").count() >= 3
    shoot(page, page.locator(".jp-OutputArea svg polyline").first, "10_trajectory")
    film = page.frame_locator(".jp-OutputArea iframe").locator("img")
    film.wait_for()
    shoot(page, page.locator(".jp-OutputArea iframe"), "10_film")
    seen = set()
    for _ in range(400):
        seen.add(film.get_attribute("src"))
        if len(seen) > 4:
            break
        page.wait_for_timeout(130)
    assert len(seen) > 4, "the film stands still"


def test_a_film_in_space_plays_in_its_cell(browser, lab, tmp_path):
    import symsimpson as ss

    top = ss.compile(ss.systems.lagrange_top())
    run = top.integrate(**top.reference_state, h=0.001, steps=1000)
    film = run.animate(seconds=10, fps=10)
    page = browser.new_page(viewport={"width": 700, "height": 760})
    page.set_default_timeout(MINUTES)
    page.route(lambda url: url.startswith("http"), lambda route: route.abort())
    page.set_content(film._repr_html_())
    inner = page.frame_locator("iframe")
    inner.locator(".slider-labels").wait_for()
    times = set()
    for _ in range(400):
        times.add(inner.locator(".slider-label").first.text_content())
        if len(times) > 3:
            break
        page.wait_for_timeout(130)
    assert len(times) > 3, "the film stands still"
    OUTPUT.mkdir(exist_ok=True)
    page.screenshot(path=OUTPUT / "film_in_space.png")
