"""Steps in C, built with the system's compiler and called from Python."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

COMPILER = shutil.which("cc") or shutil.which("gcc")
STRICT = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic"]
REALS = ctypes.POINTER(ctypes.c_double)


def build(*sources, flags=STRICT, to="-shared"):
    """Build a library, or a program, beside the first source, and return its path."""
    if COMPILER is None:
        pytest.skip("there is no compiler of C")
    target = sources[0].with_suffix(".so" if to == "-shared" else ".out")
    command = [COMPILER, *flags, to, "-fPIC", *map(str, sources), "-o", str(target), "-lm"]
    done = subprocess.run([x for x in command if x], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return target


class InC:
    """A stepper that was exported and built; what it is called with stays alive."""

    def __init__(self, stepper, folder, name="model"):
        header, source = stepper.export_c(folder / name)
        assert header.is_file()
        self.source, self.header = source, stepper.program.header
        self.library = ctypes.CDLL(str(build(source)))
        self.state = np.zeros(self.header.rows + 16)
        self.set = self.state[self.header.rows + 1 :].view(np.int32)  # the kernels that are used
        self._name = name
        self._function("energy").restype = ctypes.c_double

    def _function(self, name):
        return getattr(self.library, f"{self._name}_{name}")

    def _pointer(self, values):
        return None if values is None else np.ascontiguousarray(values).ctypes.data_as(REALS)

    def _call(self, name, h, t, *arrays):
        kept = [None if x is None else np.array(x, dtype=float) for x in arrays]
        state = ctypes.c_void_p(self.state.ctypes.data)
        given = [ctypes.c_double(h), ctypes.c_double(t), state]
        return self._function(name)(*given, *map(self._pointer, kept))

    def begin(self, h, q, p=None, v=None, parameters=None, t=0.0):
        name = "begin" if v is None else "begin_moving"
        return self._call(name, h, t, q, p if v is None else v, parameters)

    def step(self, h, t=0.0, inputs=None, parameters=None):
        return self._call("step", h, t, inputs, parameters)

    def get(self):
        q, p = np.zeros((2, self.header.n))
        state = ctypes.c_void_p(self.state.ctypes.data)
        self._function("get")(state, self._pointer(q), self._pointer(p))
        return q, p

    def energy(self, t=0.0):
        v, state = np.zeros(self.header.n), ctypes.c_void_p(self.state.ctypes.data)
        return self._function("energy")(ctypes.c_double(t), state, self._pointer(v)), v

    def run(self, h, steps, inputs=None):
        """Take steps, which all succeed, and return positions and momenta after each."""
        found = [self.get()]
        for k in range(steps):
            assert self.step(h, k * h, inputs) == 0, k
            found.append(self.get())
        return np.array(found).swapaxes(0, 1)
