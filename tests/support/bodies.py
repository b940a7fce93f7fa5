"""Bodies of SymPy's own mechanics."""

import sympy.physics.mechanics as me

import symsimpson as ss


def hanging_particle(m, l):
    """Its angle, the frame at rest, the frame that turns with it, its place, and it itself."""
    (theta,) = ss.coordinates("theta")
    frame, origin = me.ReferenceFrame("N"), me.Point("O")
    origin.set_vel(frame, 0)
    turned = frame.orientnew("A", "Axis", (theta, frame.z))
    place = origin.locatenew("P", -l * turned.y)
    place.v2pt_theory(origin, frame, turned)
    return theta, frame, turned, place, me.Particle("bob", place, m)
