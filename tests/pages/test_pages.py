"""What the pages say: their Python runs, and what they point to is there."""

import ast
import logging
import re
import subprocess

import matplotlib.pyplot as plt
import pytest
from support.cases import sweep
from support.in_c import build
from support.places import ROOT

import symsimpson as ss

GUIDE = sorted(f"notebooks/guide/{path.name}" for path in (ROOT / "notebooks/guide").glob("*.md"))
TOPICS = sorted(
    f"notebooks/topics/{path.name}" for path in (ROOT / "notebooks/topics").glob("*.md")
)
PAGES = [
    *GUIDE,
    *TOPICS,
    "notebooks/tutorial.md",
    "notebooks/how_do_i.md",
    "notebooks/index.md",
    "notebooks/versions.md",
    "README.md",
    "notebooks/README.md",
    "notebooks/coming_from.md",
    "notebooks/contributing/index.md",
    "notebooks/contributing/changes.md",
    "symsimpson/ARCHITECTURE.md",
    ".github/CONTRIBUTING.md",
    ".github/SECURITY.md",
    "symsimpson/lower/PARTS.md",
]

#: Pages of prose and commands.
WITHOUT_CODE = [
    f"notebooks/guide/{name}.md"
    for name in (
        "command_line",
        "control_details",
        "event_steps",
        "limits",
        "method",
        "paper",
        "safety",
        "speed",
    )
]


@pytest.mark.parametrize(
    "page",
    sweep(
        [
            "README.md",
            "symsimpson/lower/PARTS.md",
            "notebooks/coming_from.md",
            "notebooks/tutorial.md",
            *GUIDE,
        ]
    ),
)
@pytest.mark.filterwarnings("ignore::symsimpson.StabilityWarning")
def test_python_on_a_page_runs(page, tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    caplog.set_level(logging.NOTSET, logger="symsimpson")  # a page sets it, and this is undone
    names = {"__name__": "page"}  # what is guarded by "__main__" is left out
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text("utf-8"), re.DOTALL)
    assert blocks or page in WITHOUT_CODE
    for block in blocks:
        exec(compile(block, page, "exec"), names)


#: Pages whose output is the same on each machine.
PRINTED = [
    "README.md",
    "notebooks/tutorial.md",
    "notebooks/guide/constraints.md",
    "notebooks/guide/digits.md",
    "notebooks/guide/events.md",
    "notebooks/guide/friction.md",
    "notebooks/guide/impacts.md",
    "notebooks/guide/legs.md",
    "notebooks/guide/rolling.md",
    "notebooks/guide/skips.md",
    "notebooks/guide/status.md",
]


@pytest.mark.parametrize("page", PRINTED)
def test_what_a_page_prints_stands_there(page, capsys):
    text, names = (ROOT / page).read_text("utf-8"), {}
    found = re.findall(r"```python\n(.*?)```(?:\n+```\n(.*?)```)?", text, re.DOTALL)
    assert any(printed for _, printed in found)
    for block, printed in found:
        exec(compile(block, page, "exec"), names)
        assert not printed or capsys.readouterr().out == printed
    plt.close("all")


def test_c_on_a_page_is_built_and_says_what_stands_there(tmp_path, monkeypatch):
    text = (ROOT / "notebooks/guide/firmware.md").read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    exec(re.search(r"```python\n(.*?)```", text, re.DOTALL)[1], {})
    (tmp_path / "main.c").write_text(re.search(r"```c\n(.*?)```", text, re.DOTALL)[1])
    program = build(tmp_path / "main.c", tmp_path / "cart.c", to="")
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    assert said == re.search(r"```text\n(.*?)```", text, re.DOTALL)[1]


def texts():
    """All that users read: pages, and texts of the package."""
    for page in (ROOT / "notebooks").rglob("*.md"):
        yield page.read_text("utf-8")
    for path in (ROOT / "symsimpson").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def test_functions_and_methods_that_texts_name_are_there():
    system = ss.systems.pendulum()
    known = {"ss": ss, "symsimpson": ss, "stepper": ss.compile(system), "system": system}
    known |= {"run": ss.Trajectory, "loop": ss.ControlLoop}
    named = {x for text in texts() for x in re.findall(r"\b([a-z]+)\.([a-zA-Z_]\w*)\(", text)}
    of_two = r"`(stepper|system)\.([a-zA-Z_]\w*)`"
    named |= {x for text in texts() for x in re.findall(of_two, text)}
    named = {(owner, name) for owner, name in named if owner in known}
    assert len(named) > 50
    assert [x for x in sorted(named) if not hasattr(known[x[0]], x[1])] == []


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    text = (ROOT / page).read_text("utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert target.startswith("https://") or (ROOT / page).parent.joinpath(target).exists()
    for path in re.findall(r"`((?:notebooks|tests|symsimpson|generated)/[\w/.]+\.\w+)`", text):
        assert (ROOT / path).exists(), path


def test_files_that_the_architecture_names_are_there():
    text = (ROOT / "symsimpson/ARCHITECTURE.md").read_text("utf-8")
    paths = (*ROOT.glob("symsimpson/**/*.py"), *ROOT.glob("tests/**/*.py"))
    files = [path.as_posix() for path in paths]
    named = set(re.findall(r"`([a-z_/]+\.py)`", text))
    assert len(named) > 50
    for name in named:
        assert any(file.endswith(f"/{name}") for file in files), name


def test_every_folder_is_told_to_contributors():
    page = (ROOT / "notebooks/contributing/index.md").read_text("utf-8")
    for path in (ROOT / "symsimpson").glob("*/__init__.py"):
        assert f"symsimpson/{path.parent.name} " in page


def test_every_notebook_is_in_the_index():
    index = (ROOT / "notebooks/README.md").read_text("utf-8")
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        assert f"({path.name})" in index
