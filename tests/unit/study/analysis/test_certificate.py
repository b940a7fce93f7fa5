"""A certificate passes what is right, and fails what is wrong on the row that says why."""

import hashlib
import json
import warnings
from dataclasses import replace

import pytest
import sympy as sp
from support.cases import sweep

import symsimpson as ss
from symsimpson.api.compiling import TOOLS
from symsimpson.api.stepper import Stepper
from symsimpson.discrete.equations import discretise
from symsimpson.lower import traced_parts
from symsimpson.lower.emit import emit
from symsimpson.lower.module_kernels import lower
from symsimpson.lower.pipeline import source
from symsimpson.program.program import new_program
from symsimpson.schemes.named import read_scheme
from symsimpson.study.analysis.certificate import Check
from symsimpson.study.analysis.certify import _measure_constraints
from symsimpson.study.analysis.checks import measure_initial_momenta
from symsimpson.study.analysis.discrete_flow import DiscreteFlow
from symsimpson.study.analysis.subject import Subject
from symsimpson.study.analysis.variants import redefine_constants
from symsimpson.text.header import signed_anew
from symsimpson.text.library import library_sources
from symsimpson.text.syntax import definitions, redefined

PENDULUM = ss.systems.double_pendulum()


@pytest.mark.parametrize(
    ("name", "scheme"),
    sweep(
        [
            ("harmonic_oscillator", "midpoint"),
            ("lagrange_top", "midpoint"),
            ("lagrange_top", "simpson"),
            ("henon_heiles", "gauss4"),
            ("kepler", "lobatto6"),
            ("n_pendulum", "midpoint"),
            ("double_pendulum", "gauss16"),
        ]
    ),
)
def test_what_is_right_passes(name, scheme):
    certificate = ss.compile(ss.systems.CATALOGUE[name](), scheme).certify()
    assert certificate.passed, certificate
    assert certificate["order"].measured >= certificate.order - 0.15
    assert certificate.seconds > 0
    with pytest.raises(ss.UnknownNameError, match=r"no check 'oder'\. Did you mean order\?"):
        certificate["oder"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "rate", "scheme"),
    sweep(
        [
            ("kepler_plane", "encounters", "simpson"),
            ("kepler_plane", "encounters", "gauss16"),
            ("kepler_plane", "encounters", "kahan_li8"),
            ("double_pendulum", "kinetic", "simpson"),
            ("figure_eight", "encounters", "gauss4"),
        ]
    ),
)
def test_a_retimed_system_is_certified_in_its_own_time(name, rate, scheme):
    certificate = ss.compile(ss.systems.EVERY[name]().retimed(rate), scheme).certify()
    assert certificate.passed, certificate
    assert certificate["time"].measured >= certificate.order - 0.15
    assert certificate.parameters["E0"] != 0.0


@pytest.mark.slow
def test_a_time_by_the_ends_of_steps_fails_on_its_row():
    stepper = ss.compile(ss.systems.kepler_plane().retimed("encounters"), "simpson")
    lines = stepper.source.splitlines(keepends=True)
    first, end = definitions(stepper.source)["clock"]
    wrong = "".join(lines[first:end]).replace("WEIGHTS[node]", "(0.0 if node == 1 else 0.5)")
    text = redefined(stepper.source, {"clock": wrong})
    text = signed_anew(text)
    certificate = stepper_of(text, stepper.reference_state).certify()
    assert [check.name for check in certificate.checks if not check.passed] == ["time"]
    assert certificate["time"].measured == pytest.approx(2, abs=0.1)


def test_wrong_momenta_of_velocities_are_told(monkeypatch):
    """Steps go from q and p; a run that begins with velocities has other momenta."""
    monkeypatch.setattr(
        "symsimpson.study.analysis.certify.CHECKS", {"starts": measure_initial_momenta}
    )
    x, y = ss.coordinates("x y")
    kinetic = (x.diff() ** 2 + y.diff() ** 2) / 2 + x.diff() * y.diff() * sp.cos(x) / 4
    system = ss.MechanicalSystem(
        "skew", coordinates=(x, y), kinetic=kinetic, potential=x * x + y * y
    )
    state = {"q0": [0.6, 0.5], "v0": [0.4, -0.3]}
    stepper = ss.compile(system)
    assert not stepper.certify(**state, h=0.01).checks
    right = "p_x_of_v = v_x + s_2*v_y"
    assert stepper.source.count(right) == 1
    text = stepper.source.replace(right, right.replace("+", "-"))
    text = signed_anew(text)
    (row,) = stepper_of(text, stepper.reference_state).certify(**state, h=0.01).checks
    assert row.name == "starts"
    assert row.measured > 0.1


def rewritten_text(function, old, new):
    """A stepper of the general equations, with another text in the library."""
    sources = dict(library_sources())
    for name in function:
        assert old[name] in sources[name]
        sources[name] = sources[name].replace(old[name], new[name])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(traced_parts, "library_sources", lambda: sources)
        return built()


RESIDUAL, JACOBIAN = "assemble_residual", "assemble_entries"


def printed():
    """The paper's F_q as printed: h^2/12 and h^2/6 in place of h^2/24 and h^2/12.

    For p0 + D_0 L_d that is h (L_q,0 - L_q,2)/12 too much; and the same in its derivatives.
    """
    old = {
        RESIDUAL: "        rest = real(0)\n",
        JACOBIAN: "                        here = node * size\n",
    }
    first, last = ("W[STEP_F + a, lane]", "W[STEP_F + 2 * DIMENSION + a, lane]")
    pad = 24 * " "
    new = {
        RESIDUAL: f"        whole += ({first} - {last}) / 2\n" + old[RESIDUAL],
        JACOBIAN: old[JACOBIAN]
        + f"{pad}if k == 0:\n"
        + f"{pad}    more = (1 - node) * W[STEP_QQ + here + ab, lane] / 12\n"
        + f"{pad}    entry += h * BASIS[node, m] * more\n"
        + f"{pad}    more = (1 - node) * W[STEP_QV + here + ab, lane] / 12\n"
        + f"{pad}    entry += BASIS_SLOPE[node, m] * more\n",
    }
    return rewritten_text((RESIDUAL, JACOBIAN), old, new)


def flipped():
    """A Jacobian with the wrong sign in one of its terms."""
    old = "entry += weight * W[STEP_QV + here + ba, lane]"
    return rewritten_text((JACOBIAN,), {JACOBIAN: old}, {JACOBIAN: old.replace("+=", "-=")})


def built(scheme=ss.SIMPSON):
    equations = discretise(PENDULUM, scheme, exploit=())
    return stepper_of(emit(equations, lower(equations)))


def stepper_of(text, state=PENDULUM.reference_state):
    return Stepper(new_program(text, "known to be bad", reference_state=state, tools=TOOLS))


def once():
    """A stepper that takes a single Newton iteration a step."""
    return redefine_constants(
        ss.compile(PENDULUM), dict.fromkeys(("NEGLIGIBLE", "OWN_NEGLIGIBLE"), 'real("inf")')
    )


def rounded_table():
    quadrature = ss.SIMPSON.quadrature
    weights = tuple(sp.Rational(round(float(b) * 10**6), 10**6) for b in quadrature.weights)
    scheme = replace(ss.SIMPSON, quadrature=replace(quadrature, weights=weights))
    return stepper_of(source(PENDULUM, scheme, exploit=()))


BAD = {
    "the printed formula": (printed, {"order", "symplectic"}),
    "a sign in the Jacobian": (flipped, {"Jacobian", "Newton", "iterations"}),
    "one iteration": (once, {"rounding"}),
    "a rounded table": (rounded_table, {"order"}),
}


def failed(certificate):
    return {check.name for check in certificate.checks if not check.passed}


@pytest.mark.parametrize("name", sweep(BAD, 0))
def test_what_is_wrong_fails_where_it_should(name):
    make, rows = BAD[name]
    certificate = make().certify(h=1 / 32)
    assert not certificate.passed
    assert rows <= failed(certificate), certificate
    assert "NOT passed" in repr(certificate)


@pytest.mark.slow
def test_what_is_built_the_same_way_without_a_mistake_passes():
    assert not failed(built().certify(h=1 / 32))


@pytest.mark.slow
def test_unsolved_steps_drift():
    """One iteration from a good start leaves a residual that is no symplectic map's."""
    assert "drift" in failed(once().certify(h=1 / 16))


@pytest.mark.slow
def test_what_cannot_be_measured_has_not_passed():
    certificate = ss.compile(ss.systems.kepler()).certify([1.0, 0.0], p0=[0.0, 0.05], h=0.1)
    assert not certificate.passed
    row = next(check for check in certificate.checks if check.failure)
    assert "ConvergenceError" in row.failure
    assert row.failure in repr(certificate)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::symsimpson.errors.StabilityWarning")
@pytest.mark.filterwarnings("ignore::symsimpson.errors.ResolutionWarning")
@pytest.mark.parametrize("h", [1e5, -1e9])
def test_a_step_that_is_far_too_large_has_not_passed(h):
    """The exact motion is not followed without end: that it takes too many steps is told."""
    certificate = ss.compile(ss.systems.pendulum()).certify(h=h)
    assert not certificate.passed
    row = next(check for check in certificate.checks if check.name == "order")
    assert "needs more than 100 steps" in row.failure


@pytest.mark.slow
def test_steps_backwards_are_certified():
    """Simpson's scheme is symmetric: it has its order in both directions."""
    certificate = ss.compile(ss.systems.pendulum()).certify(h=-0.1)
    assert certificate.passed
    row = next(check for check in certificate.checks if check.name == "order")
    assert row.measured == pytest.approx(4, abs=0.15)


@pytest.mark.slow
def test_a_damped_system_is_certified_backwards_and_forwards():
    """Kernels that many digits run have the names of no arithmetic."""
    damped = ss.systems.damped_oscillator()
    stepper = ss.compile(damped, "simpson")
    for h in (0.05, -0.05):
        assert stepper.certify([1.0], [0.0], h=h).passed


@pytest.mark.slow
def test_it_is_written_and_read(tmp_path):
    certificate = ss.compile(ss.systems.pendulum()).certify()
    path = certificate.save(tmp_path / "pendulum.json")
    content = json.loads(path.read_text())
    assert content["passed"]
    assert (
        content["module"]
        == hashlib.sha256(source(ss.systems.pendulum(), "simpson").encode()).hexdigest()
    )
    assert [row["name"] for row in content["checks"]] == [c.name for c in certificate.checks]
    with pytest.raises(ss.StorageError, match="cannot be written"):
        certificate.save(tmp_path / "no" / "folder")


def test_a_file_by_itself_does_not_tell_its_forces(tmp_path):
    stepper = ss.compile(ss.systems.damped_pendulum())
    path = tmp_path / "damped.py"
    path.write_text(stepper.source, "utf-8")
    alone = ss.load(path)
    with pytest.raises(ss.InputError, match="does not contain the expressions of its forces"):
        alone.certify()


@pytest.mark.slow
def test_chaotic_motions_with_coarse_steps_change_their_level():
    """A charge in a wavy field: with h = 0.5 its energy error wanders, with h/2 it keeps still."""
    (x, y), k = ss.coordinates("x y"), sp.Symbol("k")
    charge = ss.MechanicalSystem.from_lagrangian(
        "charge",
        (x.diff() ** 2 + y.diff() ** 2) / 2 + k * x * y.diff() - x**2 - sp.cos(y),
        (x, y),
        {k: 2.0},
    )
    stepper, halved = ss.compile(charge, "lobatto6"), 0
    for k in range(4):  # rounding decides whether an energy error wanders: of some starts most do
        q0, p0 = [0.873266 + k * 1e-14, 0.542808], [-0.550832, 1.16636]
        certificate = stepper.certify(q0, p0=p0, h=0.5)
        assert certificate.passed, certificate
        halved += "h/" in certificate["drift"].what
    assert halved


def test_runs_with_a_step_that_nobody_gave_warn_of_nothing(monkeypatch):
    def coarse(subject):
        warnings.warn("take a smaller h", ss.ResolutionWarning, stacklevel=1)
        yield Check.at_most("coarse", 0.0, 1.0, "what", "why")

    monkeypatch.setattr("symsimpson.study.analysis.certify.CHECKS", {"order": coarse})
    stepper = ss.compile(PENDULUM)
    assert stepper.certify().passed
    with pytest.warns(ss.ResolutionWarning, match="smaller h"):
        stepper.certify(h=0.1)


@pytest.mark.slow
def test_constraints_are_measured_by_what_they_contain(monkeypatch):
    """A unit vector that is off by 1e-13, 7e6 m away."""
    monkeypatch.setattr(
        "symsimpson.study.analysis.certify.CHECKS", {"constraints": _measure_constraints}
    )
    x, a, b = ss.coordinates("x a b")
    craft = ss.MechanicalSystem(
        "craft",
        coordinates=(x, a, b),
        kinetic=(x.diff() ** 2 + a.diff() ** 2 + b.diff() ** 2) / 2,
        potential=0,
        constraints={"unit": a**2 + b**2 - 1},
    )
    start = {"q0": [7e6, 0.6, 0.8], "v0": [7e3, 0.4, -0.3], "h": 0.1}
    stepper = ss.compile(craft, "midpoint")
    plain = Subject.integrate

    def off(position, pull):
        def compiled(subject, *steps, **given):
            run = plain(subject, *steps, **given)
            vars(run)["constraint_error"] = run.constraint_error + position
            evaluated = run._evaluate_rows
            vars(run)["_evaluate_rows"] = lambda kernel, block, *rest, **named: (
                evaluated(kernel, block, *rest, **named) + (pull if block == "MULTIPLIER" else 0)
            )
            return run

        monkeypatch.setattr(Subject, "integrate", compiled)
        return [row.name for row in stepper.certify(**start).checks if not row.passed]

    assert off(0.0, 0.0) == []
    assert off(1e-13, 0.0) == ["constraints"]
    assert off(0.0, 1e-11) == ["velocities"]


@pytest.mark.slow
def test_newtons_method_with_other_weights_than_stages_fails():
    """Steps by stages are right, and those that Newton's method takes where they fail are not."""
    stepper = ss.compile(ss.systems.henon_heiles(), "gauss6")
    right, wrong = (f"WEIGHTS = array((real(5)/18, real(4)/9, real({last})/18))" for last in (5, 4))
    assert stepper.source.count(right) == 1
    text = stepper.source.replace(right, wrong)
    text = signed_anew(text)
    certificate = stepper_of(text, stepper.reference_state).certify()
    failed = [check.name for check in certificate.checks if not check.passed]
    assert "fallbacks" in failed
    assert certificate["order"].passed


@pytest.mark.parametrize("value", ["-correction_theta", "real('nan')"])
def test_sizes_of_corrections_that_are_none_have_not_passed(value):
    """Their root was no real number, a TypeError; NaN was taken for a step solved at once."""
    stepper = ss.compile(ss.systems.pendulum(), "simpson")
    right = "W[CORRECTION_SQUARED, lane] = correction_theta"
    assert right in stepper.source
    text = stepper.source.replace(right, right.replace("correction_theta", value))
    flow = DiscreteFlow(stepper_of(signed_anew(text)), {}, 50)
    with pytest.raises(ArithmeticError, match="a sum of squares is"):
        flow.corrections([0.5, 0.1], 0.1, 8)


def test_what_friction_has_damped_comes_back_up_to_roundings_that_grow():
    """Back over 20 steps of 2, with a rate of 3, those of 50 digits had grown to 2e-16."""
    (x,) = ss.coordinates("x")
    system = ss.MechanicalSystem(
        "door",
        coordinates=(x,),
        kinetic=x.diff() ** 2 / 2,
        potential=x**2 / 2,
        dissipation=3 * x.diff() ** 2 / 2,
    )
    certificate = ss.compile(system, "gauss6").certify([1.0], v0=[0.0], h=2.0)
    assert certificate["reversible"].passed, certificate
    assert "growth of errors" in certificate["reversible"].what


def test_what_is_not_symmetric_is_seen_though_errors_grow(monkeypatch):
    system = ss.systems.damped_pendulum()
    stepper = ss.compile(system, "radau3")
    symmetric = replace(read_scheme("radau3"), quadrature=read_scheme("gauss4").quadrature)
    monkeypatch.setattr("symsimpson.study.analysis.certify.read_scheme", lambda name: symmetric)
    certificate = stepper.certify(h=0.5)
    assert certificate["reversible"].measured > 1e-8
    assert "growth of errors" in certificate["reversible"].what
