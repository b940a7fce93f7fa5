p='symsimpson/analysis/candidates.py'
s=open(p).read()
s=s.replace('''    q: Floats = NOWHERE
    p: Floats = NOWHERE
    v: Floats = NOWHERE
''','''    q: Floats = field(default_factory=partial(np.zeros, 0))
    p: Floats = field(default_factory=partial(np.zeros, 0))
    v: Floats = field(default_factory=partial(np.zeros, 0))
''').replace('NOWHERE = np.zeros(0)\n','').replace('''from dataclasses import dataclass, field, replace
''','''from dataclasses import dataclass, field, replace
from functools import partial
''')
s=s.replace('''        if not run.success:
            self.failures.append(run.message)
        return run''','''        self.failures[:] = [] if run.success else [run.message]
        return run''')
s=s.replace('''    failures: list[str] = field''','''    #: Why the last run failed, if it did.
    failures: list[str] = field''')
open(p,'w').write(s)
p='symsimpson/analysis/choose.py'
s=open(p).read()
s=s.replace('''@waiting("choosing a scheme and a step")
@late()
@without_step_warnings()
@explained()
def choose(''','''@explained()
def choose(''')
s=s.replace('''def select(
    system''','''@waiting("choosing a scheme and a step")
@late()
@without_step_warnings()
def select(
    system''')
open(p,'w').write(s)
