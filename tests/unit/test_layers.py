"""One direction of flow: who may import whom, and what starts fast."""

import ast
import graphlib
import re
import subprocess
import sys
from functools import cache

import pytest
from support.imports import imports, room_of
from support.places import PACKAGE

#: Rooms from the ground up: each may import those before it, and no other.
ROOMS = (
    *("support", "graph", "text", "targets", "schemes", "declare", "systems", "discrete", "lower"),
    *("program", "plotting", "stepping", "results", "run", "targets.c", "api", "reference"),
    *("study", "cli"),
)
#: Rooms of texts that are run without SymPy.
RUNNING = ("targets", "program", "stepping", "results", "run", "targets.c")
#: What a file names that treats a scheme as a special one.
NAMED = "simpson|midpoint"


def loaded_by(statement):
    code = f"import sys; {statement}; print(*sorted(m.split('.')[0] for m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    return set(done.stdout.split())


def tree(path):
    return ast.parse(path.read_text("utf-8"))


def test_the_package_itself_loads_nothing_heavy():
    assert loaded_by("import symsimpson").isdisjoint({"sympy", "numba", "numpy", "mpmath"})


@pytest.mark.slow
def test_the_runtime_does_without_sympy():
    assert "sympy" not in loaded_by("import symsimpson.api.stepper")


@pytest.mark.slow
def test_the_symbolic_half_does_without_numba():
    assert "numba" not in loaded_by("import symsimpson.lower.pipeline, symsimpson.targets.binding")


@pytest.mark.parametrize("room", ROOMS)
def test_imports_point_one_way(room):
    """Those that are put off until a function runs included; types alone make no circle."""
    before = {"errors", *ROOMS[: ROOMS.index(room) + 1]}
    if room in RUNNING:
        before -= {"graph", "declare", "schemes", "systems", "discrete", "lower"}
    paths = [path for path in PACKAGE.rglob("*.py") if room_of(path) == room]
    assert paths
    for path in paths:
        for name in imports(path):
            assert room_of(name) in before, (path, name)


def test_an_import_that_is_put_off_is_seen(tmp_path):
    path = tmp_path / "late.py"
    path.write_text("""
if TYPE_CHECKING:
    from symsimpson.api.stepper import Stepper

def f():
    from symsimpson.study.analysis.certify import certify
    import symsimpson.api.compiling
""")
    assert list(imports(path)) == ["symsimpson.study.analysis.certify", "symsimpson.api.compiling"]


@cache
def all_imports():
    """What each module of the package imports of it, in whatever place, for types alone, too."""
    files = {
        ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts): path
        for path in PACKAGE.rglob("*.py")
    }
    files = {name.removesuffix(".__init__"): path for name, path in files.items()}
    imported = {}
    for name, path in files.items():
        found = set()
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.ImportFrom):
                whole = {f"{node.module}.{alias.name}" for alias in node.names}
                found |= (whole & files.keys()) or {node.module}
            elif isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
        imported[name] = (found & files.keys()) - {name}
    return imported


@pytest.mark.slow
def test_there_is_no_circle_of_imports_of_any_kind():
    graphlib.TopologicalSorter(all_imports()).prepare()  # raises where there is one


@pytest.mark.slow
def test_a_circle_would_be_found():
    below = all_imports() | {"symsimpson.errors": {"symsimpson.api.compiling"}}
    with pytest.raises(graphlib.CycleError):
        graphlib.TopologicalSorter(below).prepare()


def test_modules_stay_small():
    sizes = {path: len(path.read_text("utf-8").splitlines()) for path in PACKAGE.rglob("*.py")}
    assert max(sizes.values()) <= 500, max(sizes, key=sizes.get)


@pytest.mark.slow
def test_no_scheme_is_singled_out():
    """A scheme is data: its name is compared in the one place that names schemes."""
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text("utf-8")
        if path.name in ("scheme.py", "cli.py", "speed.py") or not re.search(NAMED, text):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Compare):
                constants = {c.value for c in ast.walk(node) if isinstance(c, ast.Constant)}
                assert constants.isdisjoint(NAMED.split("|")), path


@pytest.mark.slow
def test_declaring_does_without_sympys_mechanics():
    """It would take a third of a second to import, with its units and constants."""
    code = (
        "import sys, symsimpson as ss; ss.systems.pendulum(); print('sympy.physics' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout == "False\n"
