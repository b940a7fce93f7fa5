"""The class ``Stepper``: a compiled variational integrator of one system."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Unpack, overload

from numpy.typing import ArrayLike

from symsimpson.api.evaluator import Parameters
from symsimpson.api.orbits import OrbitFinder
from symsimpson.results.trajectory import Trajectory
from symsimpson.run.requested import run
from symsimpson.stepping.request import Request
from symsimpson.support.calling import explain_methods

if TYPE_CHECKING:
    from symsimpson.api.functions import RunFunction
    from symsimpson.results.sampled import Sampled, Saved
    from symsimpson.run.ensemble.ensemble import Ensemble
    from symsimpson.stepping.event import Event
    from symsimpson.stepping.request import RunOptions, SavedOptions, TimesOptions


@explain_methods()
class Stepper(OrbitFinder):
    """A compiled variational integrator of one system.

    :func:`symsimpson.compile` and :func:`symsimpson.load` return steppers.

    Parameters
    ----------
    program : Program
        The compiled module, with the names of the user and the values of the parameters.

    Attributes
    ----------
    system : str
        Name of the system.
    scheme : str
        Name of the scheme.
    order : int
        Order of the scheme: the error of a run is proportional to h**order.
    coordinates : tuple of str
        Names of the n coordinates, in the order of the rows of q, v and p.
    parameters : tuple of str
        Names of the parameters.
    inputs : tuple of str
        Names of the inputs.
    invariants : tuple of str
        Names of the invariants that the system declares.
    source : str
        Text of the generated module.
    program : Program
        The compiled module.
    reference_state : object or None
        The reference state of the system, if the system has one.

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
        """Integrate the equations of motion with a fixed step size.

        Parameters
        ----------
        q0 : array_like, shape (n,), or mapping
            Initial positions, in the order of ``coordinates``, or a mapping from names or symbols.
            Units are those of the system.
        v0 : array_like, shape (n,), or mapping, optional
            Initial velocities. Pass exactly one of ``v0`` and ``p0``.
        p0 : array_like, shape (n,), or mapping, optional
            Initial conjugate momenta, p = dL/dv.
        h : float
            Step size, in the unit of time. A negative step size integrates backwards.
        t_end : float, optional
            Final time. Pass exactly one of ``t_end`` and ``steps``, or ``t_eval`` alone. If h does
            not divide t_end - t0, the run takes the nearest smaller step size that does. The
            attribute ``run.h`` has its value, and ``run.message`` reports it.
        steps : int, optional
            Number of steps.
        t0 : float, default 0.0
            Initial time.

        Returns
        -------
        Trajectory, Sampled or Saved
            A :class:`Saved` if you pass ``save``, else a :class:`Sampled` if you pass ``t_eval``,
            else a :class:`Trajectory`.

        Other Parameters
        ----------------
        parameters : mapping, optional
            Values of the parameters, by symbol or name. Parameters that you do not list keep the
            values of the declaration.
        inputs : mapping, optional
            Values of the inputs of the system, by symbol or name. A value has one of these forms:

            - a number, which is constant during the run;
            - an array of shape (steps,), whose values are constant during each step;
            - an array of shape (steps, s), with a value for each node (:meth:`node_times`);
            - a function of time, which is evaluated at the nodes;
            - :func:`symsimpson.samples`, for values at a fixed rate.

            You can also pass the result of an optimal control problem.
        every : int or None, default 1
            Number of steps between stored states. The run stores the states 0, ``every``,
            2 ``every``, and so on. None stores only the final state.
        t_eval : array_like, shape (N,), optional
            Times at which to store states, in the order of the run. The run stores no others.
        save : str, symbol or sequence of them, optional
            Quantities to store instead of the states, named as in ``run["energy"]``. The names
            "q", "p" and "v" select whole vectors. You cannot combine ``save`` or ``t_eval`` with
            ``tangents``, ``sensitivities``, ``record`` or ``checkpoint``.
        tangents : int or array_like, shape (2 n, k), optional
            Variations (dq, dp) of the initial state, one per column. An integer k selects the
            first k unit vectors. ``run.tangent`` has the variations of the stored states.
        sensitivities : str, symbol or sequence of them, optional
            Parameters and inputs to differentiate the states by, at fixed q0 and fixed v0 or p0.
            ``run.sensitivity`` has the derivatives. An input is varied equally at all steps.
        record : "work", optional
            "work" integrates the work of the forces during the run. Use it if the run stores few
            states, or only the final one.
        reduce : mapping from str to (kind, expression), optional
            Quantities to evaluate at the initial state and after each step. :meth:`ensemble` lists
            the kinds. ``run.reduced`` has the results.
        events : sequence of Event, optional
            Events that act on the run: impacts, changes of the state, or terminal events.
            ``run.events(name)`` has the record of each event. The run still stores states at the
            sample times.
        exact_h : bool, default False
            True raises `InputError` if h does not divide t_end - t0.
        checkpoint : path, optional
            File for checkpoints. The same call, or :func:`symsimpson.resume`, continues an
            interrupted run, with bitwise identical states. A file beside it holds stored states.
        checkpoint_every : int, optional
            Number of steps between checkpoints. By default, the run writes one about every ten
            seconds.
        progress : bool, optional
            True shows a progress bar (needs tqdm), False shows none. By default, the bar appears
            after a second.
        on_failure : {"raise", "return"}, default "raise"
            "raise": a failed step or Ctrl-C raises an error. "return": the run returns the states
            computed so far.

        Raises
        ------
        InputError
            If an argument is invalid, M(q0) is not positive definite, or ``checkpoint`` holds
            another run.
        StorageError
            If the checkpoint cannot be read or written.
        ConvergenceError
            If a step fails. Its attribute ``trajectory`` has the states computed so far.
        Interrupted
            If you press Ctrl-C. Its attribute ``trajectory`` has the states computed so far.

        Warns
        -----
        StabilityWarning
            If h exceeds the limit of linear stability at the initial state, or does not resolve the
            fastest oscillation there.
        ResolutionWarning
            If the steps did not resolve the motion, as the energy or the passage of a singular
            point shows. The states after it are unreliable.
        ConstraintWarning
            If the constraints become nearly dependent during the run, as where a linkage folds.
        ModelWarning
            If you set a parameter that has no effect.

        Examples
        --------
        >>> import symsimpson as ss
        >>> pendulum = ss.systems.pendulum()
        >>> run = ss.compile(pendulum).integrate([1.0], v0=[0.0], h=0.05, t_end=10)
        >>> run.q.shape, bool(abs(run.energy_error).max() < 1e-5)
        ((201, 1), True)
        """
        request = Request(
            *(q0, v0, p0, h, t_end, steps, t0, parameters, inputs, every, tangents, sensitivities),
            *(t_eval, save, checkpoint, record, reduce, events, exact_h),
        )
        return run(self.program, request, checkpoint_every, progress, on_failure)

    def function(
        self,
        *,
        h: Any,
        steps: int | None = None,
        t_end: Any = None,
        of: Any = ("q", "p"),
        wrt: Any = ("q0", "p0"),
        every: int | None = None,
        q0: ArrayLike | None = None,
        v0: ArrayLike | None = None,
        p0: ArrayLike | None = None,
        t0: Any = 0.0,
        parameters: Parameters | None = None,
        inputs: Any = None,
        events: Sequence[Event] | None = None,
        exact_h: bool = False,
        threads: int | None = None,
    ) -> RunFunction:
        """Make a light function of arrays from a run, for optimisers, JAX and PyTorch.

        The function reads and checks all fixed arguments once. A call of one step costs
        less than 3 microseconds beyond the step. It has exact derivatives.

        Parameters
        ----------
        h : float
            Step size, in the unit of time.
        steps : int, optional
            Number of steps. Pass exactly one of ``steps`` and ``t_end``.
        t_end : float, optional
            Final time, as for :meth:`integrate`.
        of : str, expression or sequence of them, default ("q", "p")
            Outputs: "q", "v" and "p" are whole vectors. Other outputs are expressions, as for
            :meth:`Trajectory.events`.
        wrt : str, symbol or sequence of them, default ("q0", "p0")
            Arguments of the function, in their order: "q0", "v0" or "p0", parameters and inputs.
        every : int, optional
            Number of steps between states at which to evaluate the outputs. By default, the
            outputs belong to the final state.
        q0, v0, p0 : array_like, shape (n,) or mapping, optional
            Fixed parts of the initial state, if they are not in ``wrt``.

        Returns
        -------
        RunFunction
            The function. Its documentation gives the shapes of arguments and outputs.

        Other Parameters
        ----------------
        t0, parameters, inputs, events, exact_h
            The same arguments as for :meth:`integrate`. The shape of an input in ``inputs`` is the
            shape of the argument, if the input is in ``wrt``.
        threads : int, optional
            Number of threads for many members, as for :meth:`ensemble`.

        Raises
        ------
        InputError
            If an argument is invalid, or a part of the initial state is missing.

        Examples
        --------
        >>> import symsimpson as ss
        >>> cart = ss.compile(ss.systems.driven_cart_pole())
        >>> f = cart.function(h=0.01, steps=50, of="x", wrt="u", q0=[0.0, 0.1], v0=[0.0, 0.0])
        >>> f.jacobian([0.5] * 50).shape
        (50,)
        """
        from symsimpson.api.functions import make_function

        request = Request(
            *(q0, v0, p0, h, t_end, steps, t0, parameters, inputs, every),
            events=events,
            exact_h=exact_h,
        )
        return make_function(self.program, request, of, wrt, threads)

    def ensemble(
        self,
        q0: ArrayLike,
        v0: ArrayLike | None = None,
        *,
        p0: ArrayLike | None = None,
        h: ArrayLike,
        t_end: float | None = None,
        steps: int | None = None,
        t0: ArrayLike = 0.0,
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

        Each trajectory is an ensemble member. Members run in parallel, on SIMD lanes and threads.
        The result of a member does not depend on the other members or on the number of threads.

        Parameters
        ----------
        q0 : array_like, shape (K, n) or (n,), or mapping
            Initial positions of K members. One row of shape (n,) is the same for all members. A
            mapping has a number or an array of shape (K,) for each name or symbol.
        v0 : array_like, shape (K, n) or (n,), or mapping, optional
            Initial velocities. Pass exactly one of ``v0`` and ``p0``.
        p0 : array_like, shape (K, n) or (n,), or mapping, optional
            Initial conjugate momenta, p = dL/dv.
        h : float or array_like, shape (K,)
            Step size, in the unit of time. A negative step size integrates backwards. With an
            array, pass ``steps``.
        t_end : float, optional
            Final time. Pass exactly one of ``t_end`` and ``steps``. If h does not divide
            t_end - t0, the members take the nearest smaller step size that does.
        steps : int, optional
            Number of steps.
        t0 : float or array_like, shape (K,), default 0.0
            Initial time.
        parameters : mapping, optional
            Values of the parameters, by symbol or name: numbers, or arrays of shape (K,).
            Parameters that you do not list keep the values of the declaration.

        Returns
        -------
        Ensemble
            The stored states of all members, and the outcome of each.

        Other Parameters
        ----------------
        inputs : mapping, optional
            Values of the inputs, as for :meth:`integrate`. A first axis of length K gives each
            member its own values.
        every : int or None, default None
            Number of steps between stored states. None stores only the final state of each member.
        reduce : mapping from str to (kind, expression) or kind, optional
            Quantities to evaluate without storing states. ``found.reduced`` has one value per
            member. :meth:`Trajectory.events` describes the expressions. The kinds are:

            - "min", "max", "mean": over the initial state and the states after each step.
            - "first": the time at which the expression first becomes positive, by linear
              interpolation within a step. It is NaN if the expression never becomes positive.
              :meth:`Trajectory.events` finds zeros up to round-off.
            - "lyapunov", "megno", "sali": indicators of chaos, as in :meth:`lyapunov`. These kinds
              take no expression.
            - ("count", name): the number of times that an event acted.
        tangents : int or array_like, shape (2 n, k), optional
            Variations (dq, dp) of the initial state, as for :meth:`integrate`. They are the same
            for all members.
        sensitivities : str, symbol or sequence of them, optional
            Parameters and inputs to differentiate the states by, as for :meth:`integrate`.
        record : "work", optional
            "work" integrates the work of the forces during the run.
        events : sequence of Event, optional
            Events that act on the members, as for :meth:`integrate`. Members without an event run
            in vector blocks. A member with an event runs alone and is slower. You cannot combine
            ``events`` with ``store``.
        exact_h : bool, default False
            True raises `InputError` if h does not divide t_end - t0.
        store : path, optional
            A Zarr store for results that do not fit into memory: a folder or a URL. If the same
            call began the store, the run computes only the missing members.
        threads : int, optional
            Number of threads. By default, the number of processors.
        client : distributed.Client, optional
            A client of a cluster. Its workers compute the members and write them to ``store``.
        progress : bool, optional
            True shows a progress bar (needs tqdm), False shows none. By default, the bar appears
            after a second.
        on_failure : {"raise", "return"}, default "raise"
            "raise": Ctrl-C raises an error. "return": Ctrl-C returns the results so far. Members
            that fail never raise; ``found.status`` has the outcome of each member.

        Raises
        ------
        InputError
            If an argument is invalid, or ``store`` holds another ensemble.
        StorageError
            If the store cannot be read or written, or a task fails on the workers.
        Interrupted
            If you press Ctrl-C. Its attribute ``trajectory`` is the ensemble computed so far.

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

        request = Request(
            *(q0, v0, p0, h, t_end, steps, t0, parameters, inputs, every, tangents, sensitivities),
            record=record,
            reduce=reduce,
            events=events,
            exact_h=exact_h,
        )
        return run_ensemble(self.program, request, store, threads, client, progress, on_failure)
