"""A symbol's name is untrusted text: it reaches code only as a plain identifier."""

import ast
import re

import numpy as np
import pytest
import sympy as sp
from support.bindings import bind_float
from support.cases import sweep
from support.workspace import begin, block, take_step
from sympy.physics.mechanics import dynamicsymbols

import symsimpson as ss
from symsimpson.lower.emitted_names import NameTable, reserved_names
from symsimpson.lower.pipeline import derive, source
from symsimpson.text.header import read_header
from symsimpson.text.workspace_layout import BLOCKS

HOSTILE = [
    '__import__("os").system("touch CANARY")',
    "x\nimport os",
    "x; import os",
    'a"b',
    "a'b",
    '"""',
    "'''",
    "a\\",
    "\\n",
    "x y",
    "1x",
    "",
    " ",
    "x-y",
    "x.y",
    "f()",
    "θ",
    "ﬁ",
    "\u0430",
    "µ",
    "lambda",
    "import",
    "None",
    "match",
    "print",
    "exec",
    "__class__",
    "__builtins__",
    "_x",
    "a" * 500,
    "x\x00",
    "x\r",
    "\u202ex",
    "{x}",
    "%s",
    "#x",
    "x#",
    "@x",
]
CLASHING = [
    "h",
    "t",
    "W",
    "lane",
    "node",
    "real",
    "sincos",
    "carray",
    "math",
    "POSITION",
    "LANES",
    "ROWS",
    "c",
    "c_2",
    "s",
    "x_0",
    "lu_1_0",
    "p_q1",
    "v_q1",
    "M_q1_q1",
    "inv_det_0",
    "q1_X1",
    "active",
    "sin_q1",
    "C_1_6",
    "newton",
    "DEFAULTS",
    "sqrt",
    "metric_q1",
    "deficit",
]


def pendulum(first="q1", mass="m"):
    t = dynamicsymbols._t
    q = sp.Function(first)(t)
    (other,) = ss.coordinates("other")
    m, l = sp.Symbol(mass, positive=True), sp.Symbol("length", positive=True)
    v, w = q.diff(t), other.diff(t)
    return ss.MechanicalSystem(
        "named",
        coordinates=(q, other),
        kinetic=m * l**2 * (v**2 + w**2 / 3 + v * w * sp.cos(q - other) / 2) / 2,
        potential=-m * sp.cos(q) * sp.sqrt(2 + other**2),
        parameters={m: 1.5, l: 0.7},
    )


def motion(system):
    text = source(system)
    ast.parse(text)
    module = bind_float(text)
    W = begin(module, [0.4, 0.3], [0.1, 0.2], [1.5, 0.7], 0.05)
    for _ in range(3):
        take_step(module, W, 0.05)
    return text, W[block(module, "POSITION", 2), 0]


@pytest.fixture(scope="module")
def expected():
    return motion(pendulum())[1]


@pytest.mark.parametrize("name", sweep(HOSTILE + CLASHING))
def test_parameter(name, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text, found = motion(pendulum(mass=name))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)
    parameters = read_header(text, "here").parameters
    if name in HOSTILE:
        assert name not in parameters
        assert len(name) < 6 or name.isidentifier() or name not in text
    assert parameters[0].isidentifier()
    assert parameters[0].isascii()
    assert not list(tmp_path.iterdir())


#: The time has a name already, and names of functions have no zeros.
OF_FUNCTIONS = [n for n in HOSTILE + CLASHING if n and n != "t" and "\x00" not in n]


@pytest.mark.parametrize("name", sweep(OF_FUNCTIONS))
def test_coordinate(name, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text, found = motion(pendulum(first=name))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)
    assert len(name) < 6 or name.isidentifier() or name not in text
    assert not list(tmp_path.iterdir())


def test_rows_of_the_workspace_are_no_names():
    (x,) = ss.coordinates("x")
    rows = sp.symbols(tuple(BLOCKS))
    system = ss.MechanicalSystem(
        "rows",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=sp.Add(*rows) * x**2,
        parameters=dict.fromkeys(rows, 1.0),
    )
    names = NameTable(system)
    assert len(set(names.parameters)) == len(BLOCKS)
    assert not set(names.parameters) & set(BLOCKS)
    assert not {names.fresh(row) for row in BLOCKS} & set(BLOCKS)


@pytest.mark.slow
def test_hostile_names_still_take_values():
    system = pendulum(mass='evil"name')
    symbol = next(iter(system.parameters))
    stepper = ss.compile(system)
    runs = [
        stepper.integrate([0.4, 0.3], v0=[0, 0], h=0.05, steps=5, parameters={key: 2.5})
        for key in (symbol, 'evil"name', stepper.parameters[0])
    ]
    assert (runs[0].p == runs[1].p).all()
    assert (runs[0].p == runs[2].p).all()
    with pytest.raises(ss.InputError, match="no parameter"):
        stepper.integrate([0.4, 0.3], v0=[0, 0], h=0.05, steps=5, parameters={"evil": 1.0})


def test_names_are_the_users_own():
    text = source(ss.systems.cart_pole())
    assert "m_pole" in text
    assert "sin_theta_1, cos_theta_1 = sincos(theta_1)" in text


@pytest.mark.parametrize("name", ["rolling_disc", "damped_pendulum", "fermi_pasta_ulam"])
def test_functions_of_a_module_have_names_that_no_symbol_takes(name):
    system = getattr(ss.systems, name)()
    varied = [str(a) for a in system.parameters][:1]
    functions = [
        node.name
        for text in (source(system, "simpson"), derive(system, "simpson", varied=varied).text)
        for node in ast.parse(text).body
        if isinstance(node, ast.FunctionDef)
    ]
    families = [name for name in functions if re.search(r"_\d+$", name)]
    assert {*functions} - {*families} <= reserved_names()
