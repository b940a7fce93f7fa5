"""Contacts and dry friction as they are declared: checks, names, modes of a system."""

import pickle

import pytest
import sympy as sp
from support.friction import ball, brake, read_case, x, y

import symsimpson as ss
from symsimpson.support.contact_values import Mode


def system(**more):
    return ss.MechanicalSystem(
        "e",
        coordinates=(x, y),
        kinetic=(x.diff() ** 2 + y.diff() ** 2) / 2,
        potential=9.81 * y,
        **more,
    )


WRONG = {
    "restitution": (lambda: ss.Contact(y, restitution=1.5), "between 0"),
    "no gap": (lambda: ss.Contact("y"), "not an expression"),
    "velocity in a gap": (lambda: system(contacts=[ss.Contact(y.diff())]), "contains the velocity"),
    "gap of the time": (lambda: system(contacts=[ss.Contact(ss.time)]), "depends on no coordinate"),
    "negative limit": (lambda: ss.Friction(x.diff(), limit=-1), "negative"),
    "negative mu": (lambda: ss.Contact(y, friction=-0.1, slip=x.diff()), "negative"),
    "no limit": (lambda: ss.Friction(x.diff(), limit="1"), "neither a number"),
    "space": (lambda: ss.Contact(y, friction=0.1, slip=(x.diff(), y.diff())), "several velocities"),
    "no slip": (lambda: ss.Contact(y, friction=0.1), "no slip"),
    "slip alone": (lambda: ss.Contact(y, slip=x.diff()), "no friction"),
    "velocity in a limit": (lambda: ss.Friction(x.diff(), limit=x.diff() ** 2), "symsimpson.slip"),
    "no velocity": (lambda: ss.Friction(x, limit=1), "contains no velocity"),
    "not linear": (lambda: system(friction=[ss.Friction(x.diff() ** 2, limit=1)]), "not linear"),
    "static": (lambda: ss.Friction(x.diff(), limit=1, static=0.5), "at least as much"),
    "one name": (
        lambda: system(
            contacts={"a": ss.Contact(y)}, friction={"a": ss.Friction(x.diff(), limit=1)}
        ),
        "the name 'a'",
    ),
    "two names": (lambda: system(contacts={"a": ss.Contact(y, name="b")}), "two names"),
    "coordinate": (lambda: system(contacts={"x": ss.Contact(y)}), "a coordinate"),
    "constraint": (
        lambda: system(constraints={"a": x - y}, contacts={"a": ss.Contact(y)}),
        "a constraint",
    ),
    "kind": (lambda: system(contacts={"a": y}), "not a Contact"),
    "no mapping": (lambda: system(friction=3), "not a Friction"),
    "symbol": (lambda: system(contacts=[ss.Contact(y - sp.Symbol("c"))]), "unknown symbol c"),
    "no mode": (lambda: ball().mode({"flor": "rest"}), "Did you mean floor"),
    "no state": (lambda: ball().mode({"floor": "shut"}), "open"),
    "no modes": (lambda: ss.systems.pendulum().mode({}), "neither contacts"),
    "retimed": (lambda: ball().retimed("kinetic"), "contacts or dry friction"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_declarations_say_what_to_do(what):
    call, words = WRONG[what]
    with pytest.raises(ss.ModelError, match=words) as error:
        call()
    assert len(str(error.value).splitlines()) > 1  # the second line is the remedy


def test_names_come_from_keys_names_and_places():
    contact = ss.Contact(y, friction=0.5, slip=x.diff())
    elements = [ss.Friction(x.diff(), limit=1, name="pad"), ss.Friction(y.diff(), limit=1)]
    declared = system(contacts={"floor": contact}, friction=elements)
    assert declared.modes.names == ("floor", "floor.slip", "pad", "2")
    assert declared.modes.contact_of == (0, None, None)


def test_contacts_belong_to_the_equations():
    assert brake().digest != brake(0.4).digest
    assert brake() == pickle.loads(pickle.dumps(brake()))
    assert "Friction" in repr(brake().friction)


def test_a_mode_is_a_system():
    declared, *_ = read_case("falling_rod")
    rests = declared.mode({"tip": "rest", "tip.slip": 0})
    assert list(rests.constraints) == ["tip"]
    assert list(rests.velocity_constraints) == ["tip.slip"]
    slides = declared.mode({"tip": "rest", "tip.slip": -1})
    assert list(slides.plain.forces) == ["tip.slip"]
    assert slides.parameters[sp.Symbol("sign_tip.slip", real=True)] == -1
    assert pickle.loads(pickle.dumps(slides)).digest == slides.digest
    key = Mode((True,), (-1,)).key
    assert declared.modes.system_of(key) is declared.modes.system_of(key)


def test_the_normal_force_is_a_function_of_the_state():
    """lambda = r/D with D = n M^-1 (n - s mu A)^T, for a rod whose tip slides."""
    declared, *_ = read_case("falling_rod")
    slides = declared.mode({"tip": "rest", "tip.slip": 1})
    plain = slides.plain
    force = [sp.simplify(plain.to_sympy(value)) for value in plain.forces["tip.slip"]]
    m, J, g, length, mu, s = plain.parameters
    angle, rate = plain.q[2], plain.v[2]
    n = sp.Matrix([0, 1, length * sp.sin(angle)])
    A = sp.Matrix([1, 0, -length * sp.cos(angle)])
    inverse = sp.diag(1 / m, 1 / m, 1 / J)
    right = g - length * sp.cos(angle) * rate**2
    normal = right / (n.T * inverse * (n - s * mu * A))[0]
    wanted = -s * mu * normal * A
    assert all(sp.simplify(a - b) == 0 for a, b in zip(force, wanted, strict=True))
