p='symsimpson/analysis/path_error.py'
s=open(p).read()
i=s.index("#: It is also compared"); j=s.index("#: A variable is constant")
s=s[:i]+'''#: It is also compared at so many stored states, divided by the number of coordinates, and at as
#: many of the first ones.
STORED = 2**13
'''+s[j:]
s=s.replace('''def path_error(
    coarse: Trajectory, fine: Trajectory, duration: float, bound: float, *, dense: bool = True
) -> PathError:
    """Compare a run with one of half its step, relative to how far each variable moves.

    ``duration`` is the planned length of both runs, negative if they go backwards. ``dense`` adds
    times within steps.
    """''','''def path_error(
    coarse: Trajectory, fine: Trajectory, duration: float, bound: float
) -> PathError:
    """Compare a run with one of smaller steps, relative to how far each variable moves.

    ``duration`` is the planned length of both runs, negative if they go backwards.
    """''')
s=s.replace("_times(coarse, duration, dense=dense)","_times(coarse, duration)")
i=s.index("def _times("); j=s.index("def _difference(")
s=s[:i]+'''def _times(run: Trajectory, duration: float) -> Floats:
    """Return the times at which a run is compared, in order."""
    count = STORED // run.program.n + 1
    some = np.linspace(0, len(run) - 1, count).astype(int)
    stored = run.t[np.union1d(some, np.arange(min(len(run), count)))]
    # the last of equidistant times is the last stored one, however it was rounded
    equidistant = float(run.t[0]) + duration * np.linspace(0, 1, EQUIDISTANT)[:-1]
    times = np.union1d(equidistant, stored)
    return times if duration > 0 else times[::-1]


'''+s[j:]
open(p,'w').write(s)
p='symsimpson/analysis/candidates.py'
s=open(p).read()
s=s.replace('''#: Errors closer''','''#: A whole motion of few steps is also compared with a run of so many steps, divided by the number
#: of coordinates. It shows forces that act for a short time, between the nodes of both others.
SCOUT = 2**15
#: Errors closer''')
i=s.index("    def measure("); j=s.index("    def least(")
s=s[:i]+'''    def measure(
        self, stepper: Stepper, steps: int, coarse: Trajectory | None = None, *, scout: bool = True
    ) -> tuple[PathError, Trajectory, Trajectory | None]:
        """Return the error of so many steps, their run, and that with half the step."""
        coarse = coarse or self.run(stepper, steps)
        if not coarse.success:
            return PathError(math.inf, float(coarse.t[-1])), coarse, None
        if self.on == "energy":
            off = np.abs(coarse.energy_error)
            return PathError.of(coarse.t, off, self.error), coarse, None
        fine = self.run(stepper, 2 * steps)
        found = path_error(coarse, fine, self.duration, self.error)
        few = SCOUT // len(self.q) // steps
        if scout and found.since is None and few > 2:
            finest = self.run(stepper, 2 ** few.bit_length() * steps)
            other = path_error(coarse, finest, self.duration, self.error)
            found = max(found, other, key=lambda error: error.largest)
        return found, coarse, fine

'''+s[j:]
s=s.replace("self.measure(stepper, steps, dense=False)","self.measure(stepper, steps, scout=False)")
open(p,'w').write(s)
