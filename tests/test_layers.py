"""One direction of flow: who may import whom, and what starts fast."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "symsimpson"


def loaded_by(statement):
    code = f"import sys; {statement}; print(*sorted(m.split('.')[0] for m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    return set(done.stdout.split())


def test_the_package_itself_loads_nothing_heavy():
    assert loaded_by("import symsimpson").isdisjoint({"sympy", "numba", "numpy", "mpmath"})


def test_the_runtime_does_without_sympy():
    assert "sympy" not in loaded_by("import symsimpson.runtime.stepper")


def test_the_symbolic_half_does_without_numba():
    assert "numba" not in loaded_by("import symsimpson.codegen.pipeline, symsimpson.binding")


@pytest.mark.parametrize(
    ("folder", "forbidden"),
    [
        ("graph", {"mechanics", "schemes", "discrete", "codegen", "runtime", "api"}),
        ("mechanics", {"schemes", "discrete", "codegen", "runtime", "api"}),
        ("schemes", {"mechanics", "discrete", "codegen", "runtime", "api"}),
        ("discrete", {"codegen", "runtime", "api"}),
        ("codegen", {"runtime", "api"}),
        ("runtime", {"mechanics", "schemes", "discrete", "codegen", "api"}),
    ],
)
def test_imports_point_one_way(folder, forbidden):
    for path in (PACKAGE / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("symsimpson."):
                assert node.module.split(".")[1] not in forbidden, (path, node.module)


def test_modules_stay_small():
    sizes = {path: len(path.read_text("utf-8").splitlines()) for path in PACKAGE.rglob("*.py")}
    assert max(sizes.values()) <= 400, max(sizes, key=sizes.get)
    assert sorted(sizes.values())[len(sizes) // 2] <= 140


def test_no_scheme_is_singled_out():
    """A scheme is data: its name is compared in the one place that names schemes."""
    for path in PACKAGE.rglob("*.py"):
        if path.name in ("scheme.py", "cli.py", "speed.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Compare):
                constants = {c.value for c in ast.walk(node) if isinstance(c, ast.Constant)}
                assert constants.isdisjoint({"simpson", "midpoint"}), path
