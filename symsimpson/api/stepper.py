"""A compiled variational integrator of one system."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Unpack, overload

from numpy.typing import ArrayLike

from symsimpson.api.evaluator import Parameters
from symsimpson.api.examining import Examining
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.requested import run
from symsimpson.stepping.request import Request
from symsimpson.support.calling import explaining

if TYPE_CHECKING:
    from symsimpson.results.sampled import Sampled, Saved
    from symsimpson.run.ensemble.ensemble import Ensemble
    from symsimpson.stepping.event import Event
    from symsimpson.stepping.request import RunOptions, SavedOptions, TimesOptions


@explaining()
class Stepper(Examining):
    """A variational integrator, ready to run; made by ``compile`` and ``load``.

    Parameters
    ----------
    program : Program
        A module, compiled, with names and values.

    Attributes
    ----------
    system, scheme : str
    order : int
    coordinates, parameters, inputs, invariants : tuple of str
    source : str

    Examples
    --------
    >>> import symsimpson as ss
    >>> stepper = ss.compile(ss.systems.pendulum(), "midpoint")
    >>> stepper.system, stepper.order, stepper.coordinates, stepper.parameters
    ('pendulum', 2, ('theta',), ('m', 'l', 'g'))
    """

    def _repr_html_(self) -> str:
        from symsimpson.results.html import stepper

        return stepper(self.program)

    @overload
    def integrate(
        self, q0: ArrayLike, v0: ArrayLike | None = None, **options: Unpack[RunOptions]
    ) -> Trajectory: ...
    @overload
    def integrate(
        self, q0: ArrayLike, v0: ArrayLike | None = None, **options: Unpack[TimesOptions]
    ) -> Sampled: ...
    @overload
    def integrate(
        self, q0: ArrayLike, v0: ArrayLike | None = None, **options: Unpack[SavedOptions]
    ) -> Saved: ...
    def integrate(
        self,
        q0: ArrayLike,
        v0: ArrayLike | None = None,
        *,
        p0: ArrayLike | None = None,
        h: Any,
        t_end: Any = None,
        steps: int | None = None,
        t0: Any = 0.0,
        parameters: Parameters | None = None,
        inputs: Any = None,
        every: int | None = 1,
        t_eval: ArrayLike | None = None,
        save: Any = None,
        tangents: ArrayLike | None = None,
        sensitivities: Any = None,
        record: str | Sequence[str] | None = None,
        reduce: Mapping[str, Any] | None = None,
        events: Sequence[Event] | None = None,
        exact_h: bool = False,
        checkpoint: str | os.PathLike[str] | None = None,
        checkpoint_every: int | None = None,
        progress: bool | None = None,
        on_failure: Literal["raise", "return"] = "raise",
    ) -> Trajectory | Sampled | Saved:
        """Integrate the equations of motion with a fixed step.

        Parameters
        ----------
        q0 : array_like, shape (n,), or mapping
            Initial positions: in the order of the coordinates, or by name or symbol.
        v0, p0 : as q0
            Initial velocities or conjugate momenta: exactly one of them.
        h : float
            Step; negative to run backwards.
        t_end : float, optional
            Final time. If h does not divide the time up to it, the nearest smaller step that does
            is taken: ``run.h``, and ``run.message`` says so.
        steps : int, optional
            Number of steps; exactly one of ``t_end`` and ``steps``, unless ``t_eval`` is given.
        t0 : float
        parameters : mapping, optional
            Values by symbol or by name, in place of the defaults.
        inputs : mapping, optional
            Values of the system's inputs, by symbol or by name: a number; an array of shape
            (steps,), constant on each step; (steps, s), at its nodes (:meth:`node_times`); a
            function of time, which is evaluated at the nodes; or :func:`symsimpson.samples`. A
            result of optimal control gives its own inputs.
        every : int or None
            Number of steps between stored states. The initial state is stored; the end is stored
            if this divides the number of steps. None stores only the last state.
        t_eval : array_like, optional
            Times in the order of the run, at which alone states are kept.
        save : str, symbol or sequence of them, optional
            Quantities to keep in place of states, as in ``run["energy"]``; "q", "p" and "v" are all
            of theirs. Neither goes with derivatives, ``record`` or ``checkpoint``.
        tangents : int or array_like, shape (2 n, k), optional
            Variations (dq, dp) of the initial state, one per column; k means the first k unit
            vectors. ``run.tangent`` stores them.
        sensitivities : name, symbol or sequence of them, optional
            Parameters and inputs to differentiate by, at fixed q0 and v0 or p0; gives
            ``run.sensitivity``. An input is varied equally at all steps.
        record : "work", optional
            Adds up ``run.work`` during the run: for runs that store few states, or one.
        reduce : mapping from str to (kind, expression), optional
            Quantities to evaluate at the start and after each step, stored or not, as for
            :meth:`ensemble`; gives ``run.reduced``.
        events : sequence of Event, optional
            Events that act on the run: impacts, changes of the state, ends; ``run.events(name)``
            has the record of each. The stored states are at the sample times.
        exact_h : bool
            Whether an h that does not divide the time up to ``t_end`` is an error.
        checkpoint : path, optional
            A file from which an interrupted run is resumed, to the same bits, by the same call or
            :func:`symsimpson.resume`. Stored states go to a file beside it.
        checkpoint_every : int, optional
            Steps between checkpoints; about ten seconds unless given.
        progress : bool, optional
            Whether to show a bar (needs tqdm); None shows one after a second.
        on_failure : {"raise", "return"}
            Whether a failed step or Ctrl-C raises an error, or returns the states up to there.

        Returns
        -------
        Trajectory
            A :class:`Saved` where ``save`` is given, else a :class:`Sampled` where ``t_eval`` is.

        Raises
        ------
        InputError
            If an argument is invalid, M(q0) is not positive definite, or ``checkpoint`` holds
            another run.
        StorageError
            If the checkpoint cannot be read or written.
        ConvergenceError
            If a step failed; it carries the trajectory up to there.
        Interrupted
            At Ctrl-C; it carries the trajectory up to there.

        Warns
        -----
        StabilityWarning
            If h is beyond the limit of linear stability at the start, or does not resolve what is
            fastest there.
        ResolutionWarning
            If the energy, or a passage of a singular point, shows that steps did not resolve the
            motion; the states after it are unreliable.
        ConstraintWarning
            If constraints nearly follow from one another on the way, as where a linkage folds.
        ModelWarning
            If a parameter that is given a value has no effect.

        Examples
        --------
        >>> import symsimpson as ss
        >>> pendulum = ss.systems.pendulum()
        >>> run = ss.compile(pendulum).integrate([1.0], v0=[0.0], h=0.05, t_end=10)
        >>> run.q.shape, bool(abs(run.energy_error).max() < 1e-5)
        ((201, 1), True)
        """
        begin = q0, v0, p0, h, t_end, steps, t0
        derivatives, kept = (tangents, sensitivities), (t_eval, save, checkpoint)
        further = record, reduce, events
        request = Request(*begin, parameters, inputs, every, *derivatives, *kept, *further, exact_h)
        return run(self.program, request, checkpoint_every, progress, on_failure)

    def ensemble(
        self,
        q0: ArrayLike,
        v0: ArrayLike | None = None,
        *,
        p0: ArrayLike | None = None,
        h: float,
        t_end: float | None = None,
        steps: int | None = None,
        t0: float = 0.0,
        parameters: Parameters | None = None,
        inputs: Any = None,
        every: int | None = None,
        reduce: Mapping[str, Any] | None = None,
        tangents: ArrayLike | None = None,
        sensitivities: Any = None,
        record: str | Sequence[str] | None = None,
        events: Sequence[Event] | None = None,
        exact_h: bool = False,
        store: str | os.PathLike[str] | None = None,
        threads: int | None = None,
        client: Any = None,
        progress: bool | None = None,
        on_failure: Literal["raise", "return"] = "raise",
    ) -> Ensemble:
        """Integrate many trajectories, each with its own initial state and parameters.

        Members run in parallel, on vector lanes and threads. The result of a member does not
        depend on the other members or on the number of threads.

        Parameters
        ----------
        q0, v0, p0 : array_like, shape (K, n) or (n,), or mapping
            Initial positions, and velocities or momenta, one row for all members; numbers or arrays
            of shape (K,) by name.
        h, t_end, steps, t0, exact_h
            As for :meth:`integrate`.
        parameters : mapping, optional
            Numbers, or arrays of shape (K,), by symbol or by name.
        inputs : mapping, optional
            As for :meth:`integrate`; with an axis of K members before the others, each has its own.
        every : int or None
            As for :meth:`integrate`.
        reduce : mapping from str to (kind, expression) or kind, optional
            Quantities to evaluate without storing states. The kinds "min", "max" and "mean" are
            taken over the start and the states after each step. "first" is the time at which the
            expression first becomes positive, by linear interpolation over a step, and NaN if it
            never does; zeros to rounding are found by :meth:`Trajectory.events`, which says what
            expressions may be.
            "lyapunov", "megno" and "sali" take no expression: they measure how variations of each
            motion grow, as :meth:`lyapunov` does. ("count", name) tells how often an event acted.
        tangents, sensitivities, record
            As for :meth:`integrate`; the same variations for all members.
        events : sequence of Event, optional
            As for :meth:`integrate`. Members on which none acts run in blocks, the others each by
            itself; not with ``store``.
        store : path, optional
            A Zarr store, a folder or a URL, for results that do not fit into memory. If it was
            begun by the same call, only what is missing is computed.
        threads : int, optional
            Number of threads; by default the number of processors.
        client : distributed.Client, optional
            Lets the workers of a cluster compute, and write to ``store``.
        progress : bool, optional
            Whether to show a bar (needs tqdm); None shows one after a second.
        on_failure : {"raise", "return"}
            Whether Ctrl-C raises, or returns the results so far. Failed members do not raise.

        Returns
        -------
        Ensemble

        Raises
        ------
        InputError
            If the input makes no sense, or ``store`` holds something else.
        StorageError
            If the store cannot be read or written, or a task fails on the workers.
        Interrupted
            At Ctrl-C; its ``trajectory`` is the ensemble, as far as it is done.

        Examples
        --------
        >>> import numpy as np, symsimpson as ss
        >>> stepper = ss.compile(ss.systems.pendulum())
        >>> angles = np.linspace(0.1, 3.0, 30)[:, None]
        >>> found = stepper.ensemble(angles, v0=[0.0], h=0.05, t_end=10,
        ...                          reduce={"lowest": ("min", "theta")})
        >>> found.q.shape, bool(abs(found.reduced["lowest"][0] + 0.1) < 1e-3)
        ((30, 1), True)
        """
        from symsimpson.run.ensemble.dispatch import run_ensemble

        begin = q0, v0, p0, h, t_end, steps, t0
        asked = parameters, inputs, every, tangents, sensitivities
        further = {"record": record, "reduce": reduce, "events": events}
        request = Request(*begin, *asked, **further, exact_h=exact_h)
        return run_ensemble(self.program, request, store, threads, client, progress, on_failure)
