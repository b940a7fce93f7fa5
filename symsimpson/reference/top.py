r"""The exact motion of the Lagrange top, in any number of digits.

Let u = cos theta and G = m_top g l. The constants of the motion are p_phi, p_psi and
c = I theta'^2/2 + (p_phi - p_psi u)^2/(2 I sin^2 theta) + G u. The nutation satisfies
u'^2 = (2 G/I)(u - u1)(u - u2)(u - u3) with u1 <= u <= u2 <= 1 <= u3. Its solution is

.. math:: u(t) = u_1 + (u_2 - u_1)\,\mathrm{sn}^2(\lambda t + F_0 \mid k^2), \quad
          \lambda^2 = \frac{G}{2I}(u_3 - u_1), \quad k^2 = \frac{u_2 - u_1}{u_3 - u_1}

(Whittaker, A Treatise on the Analytical Dynamics of Particles and Rigid Bodies, section 71).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import mpmath
import numpy as np
from numpy.typing import ArrayLike

from symsimpson.support.array_types import Floats
from symsimpson.support.extras import import_library

#: Number of guard digits: digits of the computation beyond those of the results.
GUARD = 15


class ExactTop:
    """The exact motion of a Lagrange top from an initial state.

    Parameters
    ----------
    q0 : sequence of three numbers or decimal strings
        The initial angles phi, theta and psi, in rad, with 0 < theta < pi.
    v0 : sequence of three numbers or decimal strings
        The initial velocities of these angles, in rad/s.
    parameters : mapping
        The values of m_top in kg, g in m/s^2, l in m, I and I3 in kg m^2, as numbers or decimal
        strings.
    digits : int, default 15
        The number of significant digits of the results.

    Attributes
    ----------
    roots : tuple of three numbers
        The roots u1, u2 and u3 of the equation of nutation.
    p_phi, p_psi : number
        The constant momenta, in kg m^2/s.

    Raises
    ------
    ValueError
        If the parameters have other names, or theta is out of range.

    Examples
    --------
    >>> from symsimpson.reference import ExactTop
    >>> toy = {"m_top": "0.1", "g": "9.81", "l": "0.15", "I": "0.00233", "I3": "0.000125"}
    >>> top = ExactTop([0, "1.0471975511965977462", 0], ["9.2", 0, "252"], toy, digits=15)
    >>> print(top.period)
    1.84670847708164
    """

    def __init__(
        self,
        q0: Sequence[Any],
        v0: Sequence[Any],
        parameters: Mapping[str, Any],
        *,
        digits: int = 15,
    ) -> None:
        self._result_context = mpmath.mp.clone()
        self._result_context.dps = digits
        self._context = context = mpmath.mp.clone()
        context.dps = digits + GUARD
        names = ("m_top", "g", "l", "I", "I3")
        if set(map(str, parameters)) != set(names):
            raise ValueError(
                f"parameters is {parameters}. The top has the parameters {', '.join(names)}."
            )
        value = {str(key): context.mpf(x) for key, x in parameters.items()}
        self._G = value["m_top"] * value["g"] * value["l"]
        self._I, self._I3 = value["I"], value["I3"]
        self._q0 = [context.mpf(x) for x in q0]
        v_phi, self._v_theta, v_psi = (context.mpf(x) for x in v0)
        theta = self._q0[1]
        self._u0, sine = context.cos(theta), context.sin(theta)
        if not 0 < theta < context.pi:
            raise ValueError(
                f"theta0 is {theta}. The exact solution is valid only for 0 < theta0 < pi."
            )
        self.p_psi = self._I3 * (v_psi + v_phi * self._u0)
        self.p_phi = self.p_psi * self._u0 + self._I * v_phi * sine**2
        self.roots = u1, u2, u3 = self._roots(v_phi)
        self._rate = context.sqrt(self._G * (u3 - u1) / (2 * self._I))
        self._modulus = (u2 - u1) / (u3 - u1)
        self._quarter = context.ellipk(self._modulus)

    def _roots(self, v_phi: Any) -> tuple[Any, ...]:
        """Return u1 <= u2 <= u3. If theta' = 0, the initial value of u is one of them."""
        context, G, I = self._context, self._G, self._I
        p_phi, p_psi, u0 = self.p_phi, self.p_psi, self._u0
        c = I * (self._v_theta**2 + v_phi**2 * (1 - u0**2)) / 2 + G * u0
        # (1 - u^2)(2 c - 2 G u) I - (p_phi - p_psi u)^2 = 0, highest power first
        linear, constant = -2 * G * I + 2 * p_phi * p_psi, 2 * c * I - p_phi**2
        cubic = [2 * G * I, -2 * c * I - p_psi**2, linear, constant]
        if self._v_theta == 0:
            a, b = cubic[0], cubic[1] + cubic[0] * u0
            free_term = cubic[2] + b * u0
            root = context.sqrt(max(b**2 - 4 * a * free_term, context.zero))
            return tuple(sorted([u0, (-b - root) / (2 * a), (-b + root) / (2 * a)]))
        roots = context.polyroots(cubic, maxsteps=200, extraprec=4 * context.prec)
        return tuple(sorted(context.re(x) for x in roots))

    @cached_property
    def _phase(self) -> Any:
        """The phase F0 of the nutation at t = 0."""
        context = self._context
        u1, u2, _ = self.roots
        if u2 == u1:
            return context.zero
        square = min(max((self._u0 - u1) / (u2 - u1), context.zero), context.one)
        phase = context.ellipf(context.asin(context.sqrt(square)), self._modulus)
        return -phase if self._v_theta > 0 else phase

    @property
    def period(self) -> Any:
        """The period of nutation, in s."""
        return self._round(2 * self._quarter / self._rate)

    @cached_property
    def _changes(self) -> tuple[Any, Any]:
        """The changes of phi and psi in one period of nutation."""
        end = self._angles(2 * self._quarter / self._rate)
        return end[0] - self._q0[0], end[2] - self._q0[2]

    @property
    def precession(self) -> Any:
        """The change of phi in one period of nutation, in rad."""
        return self._round(self._changes[0])

    @property
    def spin(self) -> Any:
        """The change of psi in one period of nutation, in rad."""
        return self._round(self._changes[1])

    def state(self, t: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Return q = (phi, theta, psi) and p = (p_phi, p_theta, p_psi) at the time t."""
        t = self._context.mpf(t)
        q = self._angles(t)
        sn, cn, dn = (self._elliptic(name, t) for name in ("sn", "cn", "dn"))
        u1, u2, _ = self.roots
        slope = 2 * (u2 - u1) * self._rate * sn * cn * dn
        p_theta = -self._I * slope / self._context.sin(q[1])
        p = (self.p_phi, p_theta, self.p_psi)
        return tuple(map(self._round, q)), tuple(map(self._round, p))

    def theta(self, t: Any) -> Any:
        """Return theta at the time t, in rad."""
        u1, u2, _ = self.roots
        u = u1 + (u2 - u1) * self._elliptic("sn", self._context.mpf(t)) ** 2
        return self._round(self._context.acos(u))

    def theta_weierstrass(self, t: Any) -> Any:
        """Return theta at the time t, in rad, by Weierstrass's elliptic function P.

        The formula is cos theta = (2 I/G) P(t + shift) + (2 I c + p_psi^2)/(6 I G) with
        P(z) = e3 + (e1 - e3)/sn^2. The shift makes the formula correct at t = 0. If theta is
        extremal at t = 0, it is a half-period.
        """
        context = self._context
        scale = self._G / (2 * self._I)
        mean = sum(self.roots) / 3
        e3, e2, e1 = (scale * (u - mean) for u in self.roots)
        modulus = (e2 - e3) / (e1 - e3)
        omega3 = 1j * context.ellipk(1 - modulus) / context.sqrt(e1 - e3)
        z = context.mpf(t) + self._phase / self._rate + omega3
        sn = context.ellipfun("sn", z * context.sqrt(e1 - e3), m=modulus)
        P = e3 + (e1 - e3) / sn**2
        return self._round(context.acos(context.re(P / scale + mean)))

    def nutation(self, t: ArrayLike) -> Floats:
        """Return theta at the times t in double precision, in rad, with the shape of t.

        Raises
        ------
        InputError
            If SciPy is not installed (the extra ``notebooks``).
        """
        ellipj = import_library("scipy.special", "the nutation at many times", "notebooks").ellipj
        u1, u2, _ = self.roots
        turns = np.asarray(t) / float(2 * self._quarter / self._rate)
        fraction = turns - np.round(turns)
        angle = fraction * float(2 * self._quarter) + float(self._phase)
        sn = ellipj(angle, float(self._modulus))[0]
        # half angles avoid cancellation near the vertical
        sine = np.sqrt((float(1 - u2) + float(u2 - u1) * (1 - sn**2)) / 2)
        return np.asarray(2 * np.arcsin(sine))

    def _elliptic(self, name: str, t: Any) -> Any:
        """Return sn, cn or dn of the nutation at the time t."""
        return self._context.ellipfun(name, self._rate * t + self._phase, m=self._modulus)

    def _angles(self, t: Any) -> tuple[Any, Any, Any]:
        """Return phi, theta and psi at the time t with all guard digits."""
        context, rate = self._context, self._rate
        u1, u2, _ = self.roots
        u = u1 + (u2 - u1) * self._elliptic("sn", t) ** 2
        start, end = self._amplitude(self._phase), self._amplitude(rate * t + self._phase)

        def integral(characteristic: Any) -> Any:
            return context.ellippi(characteristic, end, self._modulus) - context.ellippi(
                characteristic, start, self._modulus
            )

        plus, minus = self.p_phi + self.p_psi, self.p_phi - self.p_psi
        above = plus / (2 * self._I * rate * (1 + u1)) * integral(-(u2 - u1) / (1 + u1))
        below = minus / (2 * self._I * rate * (1 - u1)) * integral((u2 - u1) / (1 - u1))
        spin = self.p_psi * (1 / self._I3 - 1 / self._I) * t
        phi0, _, psi0 = self._q0
        return phi0 + above + below, context.acos(u), psi0 + spin + above - below

    def _amplitude(self, z: Any) -> Any:
        """Return the Jacobi amplitude am(z), continuous and monotonic."""
        context = self._context
        halves = context.nint(z / (2 * self._quarter))
        remainder = z - 2 * self._quarter * halves  # cn >= 0 here
        sn, cn = (context.ellipfun(name, remainder, m=self._modulus) for name in ("sn", "cn"))
        return context.pi * halves + context.atan2(sn, cn)

    def _round(self, number: Any) -> Any:
        """Return a number with the digits of the results."""
        return self._result_context.mpf(number)
