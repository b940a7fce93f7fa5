"""Kernels that are walked: the same numbers as Python makes of their text, in every form."""

import ctypes
import re
from itertools import cycle

import numpy as np
import pytest
from numba import cfunc
from support.cases import sweep
from support.plain import QUICK
from support.workspace import walked

import symsimpson as ss
from symsimpson.discrete.reductions import read_exploit
from symsimpson.lower.pipeline import derive, source
from symsimpson.program import cache, numbers
from symsimpson.schemes.named import read_scheme
from symsimpson.systems import EVERY
from symsimpson.targets.binding import bind
from symsimpson.targets.llvm.trees import ARGUMENTS, read_text
from symsimpson.targets.llvm.values import UnsupportedConstruct
from symsimpson.targets.llvm.walker import Walker
from symsimpson.text.interface import LOOKED_AT, PIVOTED
from symsimpson.text.syntax import redefined

SCHEMES = ("simpson", "gauss8", "midpoint", "lobatto6", "gauss16")
SYSTEMS = ["pendulum", *sorted(set(EVERY) - {"pendulum"})]
KERNEL = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_double, ctypes.c_void_p)
#: Rows behind those of a module, in which variations and records stand.
ROOM = 20_000
LANES = ["pendulum", "n_pendulum", "hanging_chain", "heavy_top", "chaplygin_sleigh", "puma560"]
SIGNS = np.random.default_rng(2).choice([-1.0, 1.0], 10**6)
START = {"q0": [1.0], "v0": [0.0]}


def in_floats(text):
    """A module in Python's floats, with the tests of convergence that its text has."""
    return bind(text, {**QUICK, "array": np.array})


def names_of(text):
    functions = read_text(text).functions
    return [k for k, f in functions.items() if [a.arg for a in f.args.args] == ARGUMENTS]


def workspace(module, lanes, system):
    """Numbers for which everything has a value, in all rows; positions of a system that it has."""
    W = np.random.default_rng(1).uniform(0.2, 1.0, (module.ROWS + ROOM, lanes))
    for block in ("INCREMENT", "PREDICTED", "STAGE_V", "SOLVED"):  # a short step
        if hasattr(module, block):
            W[getattr(module, block) :][: module.UNKNOWNS] *= 1e-3
    given = {
        "ACTIVE": 1,
        "COUNT": 2,
        "STATUS": 0,
        "TANGENTS": 2,
        "STAGE_COUNT": 3,
        "STAGE_EXPECTED": 2,
        "STAGE_TURNED": 1e9,
    }
    for block, value in given.items():
        if hasattr(module, block):
            W[getattr(module, block)] = value
    if system is not None:
        q0 = list(getattr(system, "reference_state", {}).get("q0", []))
        W[module.POSITION : module.POSITION + len(q0)] = np.array(q0)[:, None]
        values = list(system.parameters.values())
        W[module.PARAMETER : module.PARAMETER + len(values)] = np.array(values)[:, None]
    if hasattr(module, "EXCHANGE"):
        W[module.EXCHANGE : module.EXCHANGE + module.UNKNOWNS + 9] = 0
    return W


def compare(text, lanes, made, wanted, system=None):
    """Call each kernel after the one before, and compare all rows."""
    module = in_floats(text)
    W = workspace(module, lanes, system)
    scratch = [row for rows in read_text(text).scratch.values() for row in rows]
    for name, kernel in made.items():
        found, right = W.copy(), W.copy()
        found[scratch] = np.nan  # no kernel reads what another one has left there
        near = W * (1 + 2.0**-50 * np.resize(SIGNS, W.shape))
        KERNEL(kernel.address)(0.01, 0.3, found.ctypes.data)
        wanted(name, right)
        wanted(name, near)  # what rounding becomes of
        # what is scratch is no result, but where a kernel is called for it, as it leaves it
        idle = np.zeros(W.shape, dtype=bool)
        idle[scratch] = W[module.ACTIVE] == 0  # nobody looks at lanes that have ended
        # of Newton's method only where no kernel with pivots is there to be looked at
        looked_at = name in LOOKED_AT and not (name == "newton" and PIVOTED in made)
        left = np.isnan(found) & (right == W) | idle if looked_at else scratch
        for rows in (found, right, near):
            rows[left] = 0.5
        finite = np.isfinite(right)
        assert (np.isfinite(found) == finite).all(), name
        size = np.maximum(1.0, np.abs(right[finite]))
        apart, moved = (np.abs(x - right)[finite] / size for x in (found, near))
        assert apart.max(initial=0.0) < 1e-12 + 1e4 * np.nanmax(moved, initial=0.0), name
        if finite.all():
            W = right


def check(system, scheme, lanes=1):
    text = scheme if "\n" in scheme else source(system, scheme)
    text = redefined(text, {"LANES": f"LANES = {lanes}"})
    module = in_floats(text)

    def in_python(name, W):
        try:
            getattr(module, name)(0.01, 0.3, W)
        except (ZeroDivisionError, OverflowError, ValueError):
            W[:] = np.nan

    made = walked(text, names_of(text), lanes)
    compare(text, lanes, made, in_python, system)


@pytest.mark.parametrize(("lanes", "name"), sweep([(1, "pendulum"), (8, "double_pendulum")], 0))
def test_numba_makes_the_same_of_the_file_as_it_stands(lanes, name):
    text = source(EVERY[name](), "midpoint")
    text = redefined(text, {"LANES": f"LANES = {lanes}"})
    module = {}
    exec(text, module)
    names = names_of(text)
    plain = {k: cfunc(module["SIGNATURE"], **module["OPTIONS"])(module[k]) for k in names}

    def by_numba(name, W):
        KERNEL(plain[name].address)(0.01, 0.3, W.ctypes.data)

    compare(text, lanes, walked(text, names, lanes), by_numba)


@pytest.mark.parametrize(("system", "scheme"), sweep(zip(SYSTEMS, cycle(SCHEMES))))
def test_all_systems(system, scheme):
    check(EVERY[system](), scheme)


@pytest.mark.parametrize(
    "system",
    sweep(
        [
            "pendulum",
            "double_pendulum",
            "cartesian_pendulum",
            "n_pendulum",
            "fermi_pasta_ulam",
            "four_bar",
            "water",
        ]
    ),
)
def test_derivatives_of_steps(system):
    one = EVERY[system]()
    check(one, derive(one, read_scheme("simpson"), read_exploit("all"), ()).text)


@pytest.mark.parametrize("scheme", sweep(["blanes_moan4", "lobatto2", "radau3", "kahan_li8"]))
def test_explicit_steps_and_others(scheme):
    check(ss.systems.henon_heiles(), scheme, lanes=8)


@pytest.mark.parametrize(
    ("system", "scheme", "lanes"),
    sweep(
        [
            ("argon", "blanes_moan4", 8),
            ("argon", "blanes_moan4", 1),
            ("hanging_chain", "suzuki4", 1),
            ("cloth", "kahan_li8", 8),
        ],
        0,
    ),
)
def test_kicks_and_drifts_by_loops(system, scheme, lanes):
    check(EVERY[system](), scheme, lanes)


@pytest.mark.parametrize("system", sweep(LANES, 1))
def test_lanes(system):
    check(EVERY[system](), "simpson", lanes=8)


@pytest.mark.parametrize(
    ("system", "scheme"), sweep([("double_pendulum", "gauss12"), ("argon", "gauss6")], 0)
)
def test_members_iterate_over_nodes(system, scheme):
    check(EVERY[system](), scheme, lanes=8)


@pytest.mark.slow
def test_retimed_systems():
    check(ss.systems.kepler().retimed("encounters"), "gauss8")


@pytest.mark.slow
def test_what_is_not_walked_is_compiled_by_numba_and_counted(monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(cache, "_results", {})
    monkeypatch.setattr(numbers, "not_walked", [])
    walked_run = ss.compile(ss.systems.pendulum(), "midpoint").integrate(**START, h=0.1, steps=40)
    assert numbers.not_walked == []

    def refuse(*_):
        raise UnsupportedConstruct("something new")

    monkeypatch.setattr(cache, "_results", {})
    monkeypatch.setattr(Walker, "_binary", refuse)
    monkeypatch.setattr(numbers, "walker_digest", lambda: "another walker")
    run = ss.compile(ss.systems.pendulum(), "midpoint").integrate(**START, h=0.1, steps=40)
    assert re.match(r"newton: line \d+: the kernel has something new: ", numbers.not_walked[0])
    assert np.abs(run.q - walked_run.q).max() < 1e-14
