"""Which small errors do the quick tests see? python tests/support/mutate.py --mutants 200 --seed 1.

One operator, comparison, constant or sign of the symbolic half is changed at a time, in a copy of
the package, and tests of numbers run against it without a compiler: in random order, so that each
gets its turn, up to the first failure. What survives points at a weak test, or changes
nothing that matters. No strings are changed, and nothing within them.
"""

import argparse
import ast
import collections
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("discrete", "schemes", "lower", "text/library")
#: Of these files all tests that are fast or plain, by folders of tests and of tests/unit.
FILES = """
lower/coefficients targets/counting lower/emit lower/expression lower/forms_and_bindings
lower/constraint_order lower/looped_stages lower/lower lower/printer lower/sincos lower/storage
lower/turning lower/untrusted_names run/gradients run/linearised discrete/angles
discrete/families discrete/jet discrete/reductions schemes/schemes stepping/constrained_start
oracle/chains oracle/compositions oracle/conformal oracle/constrained_golden oracle/curvatures
oracle/damped oracle/family oracle/forced_golden oracle/geometry oracle/reductions oracle/retimed
oracle/tangents_by_complex_steps oracle/tangents_golden
"""
#: Other tests: a file, and what is taken of it; slow ones, too.
SELECTION = """
api/rolling_files bands_give_the_same_steps_and_derivatives lower/affine what_is_not_affine
lower/forced_systems newton_solves_the_equations[0] reduced_and_general_steps_agree[0]
lower/forms_and_bindings loops_and_straight_lines_agree newton_converges_quadratically
first_step_in_many_digits lower/random_systems equations_agree_with_the_oracle[0]
newton_solves_the_equations[0]
cyclic_coordinates_follow_where_rows_are_pivoted[lagrange_top-simpson] run/gradients
the_adjoint_is_the_transpose_of_the_tangent[lagrange_top-simpson]
the_adjoint_is_the_transpose_of_the_tangent[fermi_pasta_ulam-gauss4]
the_adjoint_is_the_transpose_of_the_tangent[kepler-lobatto6] run/retimed what_is_stored[5]
time_that_stands_still_is_a_failure time_that_does_not_go_on_is_a_failure schemes/schemes
tables_agree_with_root_finding[lobatto-4-3] tables_that_modules_make[gauss6]
tables_that_modules_make[lobatto16] oracle/chains compositions_of_rattle_keep_their_order
oracle/compositions loops_are_straight_lines[suzuki4] oracle/family
stages_solve_the_equations[top-gauss6] oracle/reductions chain[lobatto2] oracle/rolling_orders
work_of_constraints_has_the_order_of_the_scheme[gauss4]
oracle/rolling_golden golden_runs[affine_forced_simpson] golden_runs[turntable_simpson]
oracle/tangents_constrained derivatives_by_parameters[four_bar-gauss4]
derivatives_by_the_state[four_bar-gauss4] derivatives_in_bands_are_those_of_the_whole_matrix
the_adjoint_is_the_transpose_of_the_tangent[four_bar-gauss4]
the_adjoint_is_the_transpose_of_the_tangent[quaternion_top-midpoint]
oracle/tangents_rolling derivatives_by_the_state[carried-simpson]
derivatives_by_parameters[carried-gauss6] derivatives_by_the_step[carried-gauss6]
the_adjoint_is_the_transpose_of_the_tangent[carried-gauss6]
the_adjoint_is_the_transpose_of_the_tangent[snakeboard-lobatto6]
the_adjoint_is_the_transpose_of_the_tangent[ball_on_turntable-midpoint]
"""
SWAPS = "+:- -:+ *:/ /:* **:* //:* %:* |:& &:| <:<= <=:< >:>= >=:> ==:!= !=:== is:is_not is_not:is"
SWAPS += " in:not_in not_in:in and:or or:and"
OTHER = dict(pair.replace("_", " ").split(":") for pair in SWAPS.split())
SYMBOL = re.compile(r"\*\*|//|[<>=!]=|[-+*/%|&<>]|\b(?:is not|is|not in|in|and|or)\b")
PYTEST = f"{sys.executable} -m pytest --plain --cases every -q".split()
SILENT = ("annotation", "returns", "decorator_list")
OPERATIONS = (ast.BinOp, ast.BoolOp, ast.Compare, ast.AugAssign)


def walk(node):
    """Give every node in which a change may matter: no errors, texts, checks, lists of names."""
    yield node
    for name, value in ast.iter_fields(node):
        for child in (value if isinstance(value, list) else [value]) * (name not in SILENT):
            names = {getattr(target, "id", "") for target in getattr(child, "targets", ())}
            if isinstance(child, ast.AST) and not (
                isinstance(child, ast.Raise | ast.Assert | ast.JoinedStr)
                or "__all__" in names
                or getattr(child, "arg", "") == "strict"
            ):
                yield from walk(child)


def changes(text):
    """Give (line, first byte, last byte, new bytes) of every change of a module."""
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node in walk(ast.parse(text)):
        parts = [part for part in ast.iter_child_nodes(node) if isinstance(part, ast.expr)]
        for left, right in pairwise(parts if isinstance(node, OPERATIONS) else ()):
            first = starts[left.end_lineno - 1] + left.end_col_offset
            between = text[first : starts[right.lineno - 1] + right.col_offset].decode()
            found = list(SYMBOL.finditer(between))
            if len(found) == 1 and "#" not in between:
                symbol, first = found[0][0], first + found[0].start()
                yield left.end_lineno, first, first + len(symbol), OTHER[symbol].encode()
        first = starts[getattr(node, "lineno", 1) - 1] + getattr(node, "col_offset", 0)
        if isinstance(node, ast.UnaryOp):
            last = starts[node.operand.lineno - 1] + node.operand.col_offset
            if text[first:last].strip() in (b"-", b"not"):  # no bracket is lost
                yield node.lineno, first, last, b""
        elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            new = not node.value if isinstance(node.value, bool) else node.value + 1
            last = starts[node.end_lineno - 1] + node.end_col_offset
            yield node.lineno, first, last, repr(new).encode()


def path_of(word):
    """Return the file of tests that a word of the selection means."""
    folder, name = word.split("/")
    return f"tests/{folder if folder == 'oracle' else f'unit/{folder}'}/test_{name}.py"


def selection():
    """Give the selected tests, each once: files and tests begin with "test_"."""
    named = []
    for word in SELECTION.split():
        if "/" in word:
            file = path_of(word)
        else:
            named.append(f"{file}::test_{word}")
    quick = collected("-m", "not slow or plain", *map(path_of, FILES.split()))
    return list(dict.fromkeys([*collected(*named), *quick]))


def collected(*words):
    """Give the tests that words of pytest's command line mean."""
    command = [*PYTEST, "--collect-only", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stdout)
    return [line for line in done.stdout.splitlines() if "::" in line]


def run(copy, tests, limit):
    """Run tests in the copy; give how it ended, and the tests that are named as failed."""
    command = [*PYTEST, "-x", "-p", "no:cacheprovider", "--tb=no", "-rfE"]
    changed = {"PYTHONPATH": str(copy), "SYMSIMPSON_CACHE_DIR": str(copy / "cache")}
    given = {"cwd": copy, "timeout": limit, "capture_output": True, "text": True}
    given["env"] = os.environ | changed | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    try:
        done = subprocess.run([*command, *tests], **given)
    except subprocess.TimeoutExpired:
        return "timed out", []
    named = re.findall(r"\n(?:FAILED|ERROR) (.+?)(?: - |\n)", done.stdout)
    return "killed" if done.returncode else "survived", named


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    numbers = {"mutants": 200, "first": 0, "seed": 1, "limit": 240.0, "minutes": 1e9}
    for name, default in numbers.items():  # limit: in seconds; first: so many were run before
        parser.add_argument(f"--{name}", type=type(default), default=default)
    parser.add_argument("tests", nargs="*", help="default: the selection")
    options = parser.parse_args()
    pick, begun, counts = random.Random(options.seed), time.time(), collections.Counter()
    paths = sorted(p for f in FOLDERS for p in (ROOT / "symsimpson" / f).rglob("*.py"))
    places = [(path, *change) for path in paths for change in changes(path.read_bytes())]
    tests = silent = options.tests or selection()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("symsimpson", "tests"):
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy2(ROOT / "pyproject.toml", copy)
        if (found := run(copy, tests, 10 * options.limit))[0] != "survived":
            sys.exit(f"without any change: {found}")
        for path, line, first, last, new in pick.sample(places, options.mutants)[options.first :]:
            if time.time() - begun > 60 * options.minutes:
                break
            text, where = path.read_bytes(), path.relative_to(ROOT)
            (copy / where).write_bytes(text[:first] + new + text[last:])
            verdict, failed = run(copy, pick.sample(tests, len(tests)), options.limit)
            shutil.copy2(path, copy / where)
            counts[verdict] += 1
            failed += [name.split("[")[0] for name in failed]
            silent = [name for name in silent if name not in failed]
            around = text.splitlines()[line - 1].strip()
            before, new, around = (part.decode() for part in (text[first:last], new, around))
            print(f"{verdict}: {where}:{line}: {before!r} -> {new!r} in {around}", flush=True)
    print(len(places), "places;", *(f"{n} {verdict}" for verdict, n in counts.items()))
    print("never the first to fail:", *silent, sep="\n  ")


if __name__ == "__main__":
    main()
