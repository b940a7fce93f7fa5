"""What the core alone does, where none of the libraries that are extras is installed."""

import subprocess
import sys

import pytest

BARE = """
import sys

class Nowhere:
    extras = ("flint gmpy2 scipy matplotlib plotly xarray pandas zarr netCDF4 tqdm distributed "
              "casadi heyoka diffrax jax imageio_ffmpeg shtab IPython").split()

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.extras:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Nowhere())
sys.modules.update(dict.fromkeys(Nowhere.extras))
import warnings

warnings.simplefilter("error")
import symsimpson as ss

"""
USES = {
    "a run": """
run = ss.compile(ss.systems.double_pendulum()).integrate([1, 1], p0=[0, 0], h=0.01, steps=200)
assert abs(run.energy_error).max() < 1e-5
assert run["q1"].shape == run.at(run.t)["q1"].shape and run.events("q1").t.size
assert run._repr_html_() and repr(run)
""",
    "many digits": """
system = ss.systems.pendulum()
run = ss.compile(system, "gauss8", precision=40).integrate(["1"], v0=[0], h="0.1", steps=3)
assert abs(run.energy_error).max() < 1e-8
""",
    "members": """
import numpy as np
found = ss.compile(ss.systems.pendulum()).ensemble(np.ones((20, 1)), v0=[0.0], h=0.1, steps=10)
assert found.status.sum() == 0 and found._repr_html_()
""",
    "a certificate": """
certificate = ss.compile(ss.systems.cartesian_pendulum()).certify()
assert certificate.passed, certificate
""",
    "a file": """
import pathlib, tempfile
run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=0.1, steps=10)
place = pathlib.Path(tempfile.mkdtemp())
run.save(place / "run.npz")
try:
    run.save(place / "run.nc")
except ss.InputError as error:
    assert "pip install" in str(error)
else:
    raise AssertionError("written without a library")
""",
}


@pytest.mark.parametrize(
    "use", [pytest.param(x, marks=[] if x == "a certificate" else pytest.mark.slow) for x in USES]
)
def test_the_core_does_without(use):
    ended = subprocess.run(
        [sys.executable, "-c", BARE + USES[use]], capture_output=True, text=True, timeout=300
    )
    assert ended.returncode == 0, ended.stderr
