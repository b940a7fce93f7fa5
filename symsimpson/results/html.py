"""HTML representations of steppers and results, for notebooks."""

from __future__ import annotations

import html
from typing import Any

import numpy as np

from symsimpson.program.program import Program
from symsimpson.program.status import Status
from symsimpson.support.markup import Markup, box, curves, facts, scatter
from symsimpson.support.names import counted

#: The largest number of coordinates that have a picture each.
DRAWN = 6
GOOD, BAD = "#3a9e6b", "#d1495b"


def stepper(program: Program) -> str:
    """Show the system, scheme and module of a stepper, and how it solves a step."""
    values = ", ".join(f"{k} = {float(v):g}" for k, v in program.named_values().items())
    solved = "explicit, or one matrix for all"
    unknowns = program.header.newton_unknowns
    if unknowns:
        solved = "Newton's method with the exact Jacobian"
        if program.header.by_stages:
            solved = f"iterated over {program.header.layout['NODES']} stages; else {solved}"
    lines = program.source.count("\n")
    rows = [
        ("scheme", f"{program.scheme}, order {program.order}"),
        ("coordinates", ", ".join(program.coordinates)),
        ("parameters", values or "none"),
        ("invariants", ", ".join(program.invariants) or "none declared"),
        ("a step", solved),
        ("Newton unknowns", unknowns or "none"),
        ("module", f"{lines} lines; print(stepper.source) shows them"),
        ("compiled code", program.kernels.location),
    ]
    return box(f"Stepper of {program.system}", facts(rows))


def states(some: Any) -> str:
    """Show states, with a picture of each coordinate."""
    return box(repr(some), facts(_coordinate_pictures(some)))


def events(crossings: Any) -> str:
    """Show the zeros of an expression, with a phase portrait of each coordinate."""
    rows: list[tuple[str, Any]] = [("zeros of", crossings.expression)]
    if crossings.status is not Status.SUCCESS:
        rows.append(("the run", verdict(crossings.message, False)))
    if len(crossings) > 1:
        rows += [
            (f"{q} and p_{q}", scatter(crossings[q], crossings[f"p_{q}"]))
            for q in crossings.program.coordinates[:DRAWN]
        ]
    return box(repr(crossings), facts(rows))


def trajectory(run: Any) -> str:
    """Show the outcome of a run, with pictures of its coordinates and its energy."""
    rows: list[tuple[str, Any]] = [
        ("scheme", f"{run.program.scheme}, order {run.program.order}"),
        ("steps", f"{run.steps} of h = {float(run.h):g}, {counted(len(run), 'state')} stored"),
        ("status", verdict(run.status.name, run.success)),
    ]
    if not run.success:
        rows.append(("message", run.message))
    iterations = iterations_a_step(run)
    if iterations:
        rows.append(("iterations a step", f"{iterations:.2f}"))
    if run.history is not None:
        rows.append(("modes", f"{len(run.history)}, of {', '.join(run.history.names)}"))
    constant = run.has_constant_energy
    known = constant and (run.every is not None or run.begun is not None)
    energy = np.asarray(run.energy_error if known else run.energy, dtype=float)
    if known:
        name = "largest energy error" if len(run) > 1 else "energy error at the end"
        rows.append((name, f"{np.abs(energy).max():.2g}"))
    if len(run) > 1:
        rows += _coordinate_pictures(run)
        rows.append(("energy error" if constant else "energy", curves(run.t, [energy])))
    return box(f"Trajectory of {run.program.system}", facts(rows))


def iterations_a_step(run: Any) -> float | None:
    """Return the mean Newton iterations per step, up to the last stored state; None for 0 steps."""
    steps = run.steps if run.every is None else min((len(run) - 1) * run.every, run.steps)
    return float(run.newton_iterations.sum()) / steps if steps else None


def _coordinate_pictures(some: Any) -> list[tuple[str, Any]]:
    """Return a picture of each coordinate, or one of the first coordinates if there are many."""
    names = some.program.coordinates
    if len(some) < 2:
        return [(name, f"{float(some[name][0]):.6g}") for name in names[:DRAWN] if len(some)]
    if len(names) > DRAWN:
        return [(f"{names[0]}, ..., {names[-1]}", curves(some.t, list(some.q.T[:DRAWN])))]
    return [(name, curves(some.t, [some[name]])) for name in names]


def ensemble(members: Any, t_end: float) -> str:
    """Show the outcome of an ensemble, with a picture of the final states."""
    names = members.program.coordinates
    good = bool((members.status == Status.SUCCESS).all())
    rows: list[tuple[str, Any]] = [
        ("scheme", f"{members.program.scheme}, order {members.program.order}"),
        ("members", len(members)),
        ("to t", f"{t_end:g}, {counted(members.stored, 'state')} of each stored"),
        ("status", verdict(members.message, good)),
    ]
    if members.store is not None:
        rows.append(("store", members.store))
    elif len(members) > 1:
        last = members.q[:, -1] if members.q.ndim == 3 else members.q
        x, y = (last[:, 0], last[:, 1]) if len(names) > 1 else (np.arange(len(last)), last[:, 0])
        what = f"{names[1]} over {names[0]}" if len(names) > 1 else f"{names[0]} of each member"
        rows.append((f"ends: {what}", scatter(x, y)))
    for name, values in members.reduced.items():
        rows.append((name, curves(np.arange(len(values)), [np.sort(values)])))
    return box(f"Ensemble of {members.program.system}", facts(rows))


def solution(result: Any) -> str:
    """Show the solution of an optimal control problem: coordinates and inputs over time."""
    t, columns = result.t, dict(zip(result.layout.problem.names, result.q.T, strict=True))
    columns |= result.inputs(t)
    rows: list[tuple[str, Any]] = [
        ("cost", f"{result.cost:.9g}"),
        ("duration", f"{result.duration:.9g}"),
        ("status", verdict(result.message, result.success)),
        *[(name, f"{value:.6g}") for name, value in result.unknowns.items()],
        *[(name, curves(t, [column])) for name, column in [*columns.items()][: 2 * DRAWN]],
    ]
    return box(repr(result), facts(rows))


def chaos(result: Any) -> str:
    """Show Lyapunov exponents over time, and other indicators of chaos at the final time."""
    rows: list[tuple[str, Any]] = [
        ("exponents", ", ".join(f"{x:.4g}" for x in result.exponents)),
        ("over time", curves(result.t, list(result.history.T))),
        ("megno", f"{result.megno[-1]:.4g}"),
        ("sali", f"{result.sali[-1]:.3g}"),
        ("to t", f"{result.t[-1]:g}"),
    ]
    return box(f"Lyapunov exponents of {result.trajectory.program.system}", facts(rows))


def verdict(text: str, good: bool) -> Markup:
    """Return a text in green if it is ``good``, else in red."""
    return Markup(f'<span style="color: {GOOD if good else BAD}">{html.escape(text)}</span>')
