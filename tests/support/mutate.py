"""Which small errors do the quick tests see? python tests/support/mutate.py --mutants 200 --seed 1.

One operator, comparison, constant or sign of the symbolic half is changed at a time, in a copy of
the package, and tests of numbers that need no compiler run against it: in random order, so that
each gets its turn, up to the first failure. What survives points at a weak test, or changes
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
FOLDERS = ("discrete", "schemes", "codegen")
SELECTION = """
codegen/random_systems equations_agree_with_the_oracle[0] newton_solves_the_equations[0]
codegen/forms_and_bindings loops_and_straight_lines_agree[0-exploit2-simpson-lagrange_top]
first_step_in_many_digits[dp_w2_simpson_h0.1_N100]
first_step_in_many_digits[top_I0.00233_simpson_tbar37_N37] codegen/lower
values_move_to_the_next_step_in_the_order_of_their_names
a_sum_of_known_angles_needs_no_sine_of_its_own a_sine_that_something_is_divided_by_keeps_its_digits
codegen/counting straight_lines_are_counted_as_their_sections_say[exploit0-kepler]
a_direct_step_has_no_iteration discrete/families
families_add_up_to_the_lagrangian[double_pendulum-6] terms_of_other_signs_and_orders_are_one_family
a_shuffled_chain_gets_its_order_back discrete/jet jet_agrees_with_differences[lagrange_top]
discrete/reductions annihilating_combinations shears_multiply_to_the_step
factors_of_the_top_have_no_subtraction factors_multiply_to_the_matrix[1]
every_coordinate_is_in_one_part[exploit3] schemes/schemes tables_agree_with_root_finding[gauss-3-3]
tables_agree_with_root_finding[lobatto-4-3] order_of_the_quadrature[lobatto-4-3]
the_predictor_continues_polynomials[simpson] elimination_meets_no_singular_pivot[gauss6]
tables_that_modules_make[gauss6] tables_that_modules_make[lobatto16] names unknown_schemes
oracle/compositions coefficients oracle/reductions linear_system_against_its_matrix
catalogue[pendulum-simpson] chain[lobatto2] oracle/family
stages_solve_the_equations[top-gauss6]
"""
SWAPS = "+:- -:+ *:/ /:* **:* //:* %:* |:& &:| <:<= <=:< >:>= >=:> ==:!= !=:== is:is_not is_not:is"
SWAPS += " in:not_in not_in:in and:or or:and"
OTHER = dict(pair.replace("_", " ").split(":") for pair in SWAPS.split())
SYMBOL = re.compile(r"\*\*|//|[<>=!]=|[-+*/%|&<>]|\b(?:is not|is|not in|in|and|or)\b")
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


def selection():
    """Give the selected tests as pytest names them: files and tests begin with "test_"."""
    for word in SELECTION.split():
        if "/" in word:
            folder, name = word.split("/")
            file = f"{folder if folder == 'oracle' else f'unit/{folder}'}/test_{name}"
        else:
            yield f"tests/{file}.py::test_{word}"


def run(copy, tests, limit):
    """Run tests in the copy; give how it ended, and the tests that are named as failed."""
    command = f"{sys.executable} -m pytest --plain --cases every -x -q -p no:cacheprovider --tb=no -rfE".split()
    changed = {"PYTHONPATH": str(copy), "SYMSIMPSON_CACHE_DIR": str(copy / "cache")}
    given = {"cwd": copy, "timeout": limit, "capture_output": True, "text": True}
    given["env"] = os.environ | changed | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    try:
        done = subprocess.run([*command, *tests], **given)
    except subprocess.TimeoutExpired:
        return "timed out", []
    named = re.findall(r"\n(?:FAILED|ERROR) (\S+)", done.stdout)
    return "killed" if done.returncode else "survived", named


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    numbers = {"mutants": 200, "first": 0, "seed": 1, "limit": 60.0, "minutes": 1e9}
    for name, default in numbers.items():  # limit: in seconds; first: so many were run before
        parser.add_argument(f"--{name}", type=type(default), default=default)
    parser.add_argument("tests", nargs="*", default=[*selection()])
    options = parser.parse_args()
    pick, begun, counts = random.Random(options.seed), time.time(), collections.Counter()
    paths = sorted(p for f in FOLDERS for p in (ROOT / "symsimpson" / f).rglob("*.py"))
    places = [(path, *change) for path in paths for change in changes(path.read_bytes())]
    tests = silent = options.tests
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
