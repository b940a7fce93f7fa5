"""Trajectories in files."""

import random
import shutil
import subprocess
import sys

import numpy as np
import pytest
import sympy as sp
import xarray
from support.cases import sweep

import symsimpson as ss

CASES = [
    ("double_pendulum", "simpson", {}),
    ("lagrange_top", "gauss8", {"every": 7}),
    ("harmonic_oscillator", "midpoint", {"every": None}),
    ("henon_heiles", "blanes_moan4", {}),
]


def run_of(name, scheme, **options):
    system = getattr(ss.systems, name)()
    start = dict(system.reference_state)
    return ss.compile(system, scheme).integrate(
        start.pop("q0"), **start, h=0.01, steps=70, **options
    )


@pytest.mark.parametrize("ending", ["nc", "zarr"])
@pytest.mark.parametrize(("name", "scheme", "options"), sweep(CASES))
def test_what_is_opened_is_what_was_saved(tmp_path, name, scheme, options, ending):
    run = run_of(name, scheme, **options)
    path = tmp_path / f"run.{ending}"
    for _ in range(2):  # a second time over the first
        run.save(path)
    found = ss.open_trajectory(path)
    for what in ("t", "q", "p", "v", "energy", "newton_iterations"):
        assert (getattr(found, what) == getattr(run, what)).all(), what
    assert dict(found.parameters) == dict(run.parameters)
    for what in ("h", "steps", "every", "status", "message"):
        assert getattr(found, what) == getattr(run, what), what
    assert list(found.invariants) == list(run.invariants)
    if run.every:
        assert (found.sol(0.123) == run.sol(0.123)).all()
    assert found.program.source == run.program.source


@pytest.mark.parametrize(("t0", "h"), [(1e9, 1e-3), (0.0, 1e-10), (-5.0, 0.1), (1e6, -1e-4)])
def test_times_of_any_kind(tmp_path, t0, h):
    run = ss.compile(ss.systems.pendulum()).integrate([1.0], v0=[0.0], h=h, steps=50, t0=t0)
    run.save(tmp_path / "run.nc")
    assert (ss.open_trajectory(tmp_path / "run.nc").t == run.t).all()


@pytest.mark.parametrize("ending", sweep(["nc", "zarr"]))
def test_opened_runs_have_the_same_events(tmp_path, ending):
    """Arrays of files may be read-only: in a fresh process, as Numba remembers what it has seen."""
    run, path = run_of("double_pendulum", "simpson"), tmp_path / f"run.{ending}"
    run.save(path)
    code = (
        "import symsimpson as ss; "
        f"print(ss.open_trajectory({str(path)!r}).events('q2 - 0.9').t.tolist())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    expected = run.events("q2 - 0.9").t.tolist()
    assert len(expected) == 1
    assert done.stdout.strip() == str(expected)


@pytest.mark.parametrize("ending", ["nc", "zarr"])
def test_results_that_are_no_runs_are_told(tmp_path, ending):
    stepper, path = ss.compile(ss.systems.pendulum()), tmp_path / f"run.{ending}"
    stepper.integrate([1.0], v0=[0.0], h=0.1, t_eval=[0.0, 0.25]).save(path)
    opener = {"nc": "open_dataset", "zarr": "open_zarr"}[ending]
    with pytest.raises(ss.StorageError, match=rf"is not a whole run.*\n.*{opener}.*t_eval="):
        ss.open_trajectory(path)


@pytest.mark.parametrize("ending", sweep(["nc", "zarr"]))
def test_names_of_the_user_are_kept(tmp_path, ending):
    theta, rate = sp.Function(r"\theta")(ss.time), sp.Symbol("lambda", positive=True)
    system = ss.MechanicalSystem(
        "named",
        coordinates=(theta,),
        kinetic=theta.diff() ** 2 / 2,
        potential=-rate * sp.cos(theta),
        parameters={rate: 2.0},
    )
    run = ss.compile(system).integrate([1.0], v0=[0.0], h=0.1, steps=20)
    path = tmp_path / f"run.{ending}"
    run.save(path)
    again = ss.open_trajectory(path)
    assert dict(again.parameters) == {"lambda": 2.0}
    assert (again[r"\theta"] == run[r"\theta"]).all()
    assert (again.events(theta).t == run.events(theta).t).all()


def test_others_can_read_it(tmp_path):
    run = run_of("lagrange_top", "simpson")
    run.save(tmp_path / "run.nc")
    with xarray.open_dataset(tmp_path / "run.nc", engine="netcdf4") as data:
        assert data["q"].dims == ("time", "coord")
        assert data["coord"].values.tolist() == list(run.program.coordinates)
        assert data["p"].attrs["long_name"] == "conjugate momentum"
        assert data.attrs["scheme"] == "simpson"


@pytest.mark.parametrize("name", ["run", "run.txt", "run.nc.gz"])
def test_other_endings_are_refused(tmp_path, name):
    run = run_of("double_pendulum", "simpson")
    with pytest.raises(ss.InputError, match=r"Use .nc"):
        run.save(tmp_path / name)
    with pytest.raises(ss.InputError, match=r"Use .nc"):
        ss.open_trajectory(tmp_path / name)


def test_what_cannot_be_written_or_read(tmp_path):
    run = run_of("double_pendulum", "simpson")
    with pytest.raises(ss.StorageError, match=r"there is no folder .*such") as caught:
        run.save(tmp_path / "no" / "such" / "place.nc")
    assert caught.value.trajectory is run
    for ending in ("nc", "zarr"):
        with pytest.raises(ss.StorageError, match="there is no such file"):
            ss.open_trajectory(tmp_path / f"none.{ending}")
    digits = ss.compile(ss.systems.pendulum(), precision=30)
    with pytest.raises(ss.InputError, match="many digits"):
        digits.integrate([1.0], v0=[0.0], h=0.1, steps=2).save(tmp_path / "digits.nc")


def test_an_interrupted_save_keeps_the_file_before(tmp_path, monkeypatch):
    path = tmp_path / "run.nc"
    run = run_of("double_pendulum", "simpson")
    run.save(path)
    before = path.read_bytes()

    def fail(self, where, **options):
        where.write_bytes(b"half")
        raise OSError("no space left")

    monkeypatch.setattr(xarray.Dataset, "to_netcdf", fail)
    with pytest.raises(ss.StorageError, match="no space left"):
        run.save(path)
    assert path.read_bytes() == before


def changed(path, change):
    with xarray.open_dataset(path, engine="netcdf4") as opened:
        data = opened.load()
    data = change(data)
    data.to_netcdf(path, engine="netcdf4", mode="w")


def with_module(data, edit):
    text = edit(data["module"].values.tobytes().decode()).encode()
    data = data.drop_vars("module")
    data["module"] = (("byte",), np.frombuffer(text, dtype=np.uint8))
    return data


def hostile(text):
    return resigned(text, "\nopen('canary', 'w').close()\n")


def resigned(text, more):
    from symsimpson.text.header import SIGNED, digest

    found = SIGNED.search(text)
    body = text[found.end() :] + more
    return text[: found.start(1)] + digest(body) + text[found.end(1) : found.end()] + body


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda d: d.drop_vars("p"), ss.StorageError, "has no 'p'"),
        (lambda d: d.drop_attrs(), ss.StorageError, "has no 'h'"),
        (lambda d: d.assign_attrs(status="FINE"), ss.StorageError, "contradicts"),
        (lambda d: d.assign(q=d["q"] + 1e-16), ss.StorageError, "digest"),
        (lambda d: d.assign_attrs(h=0.02), ss.StorageError, "contradicts"),
        (lambda d: d.assign_attrs(h=np.nan), ss.StorageError, "contradicts"),
        (lambda d: d.assign_attrs(steps=71), ss.StorageError, "contradicts"),
        (lambda d: d.assign_attrs(parameter_values=[1.0]), ss.StorageError, "contradicts"),
        (lambda d: d.isel(coord=[0]), ss.StorageError, "contradicts"),
        (
            lambda d: with_module(d, lambda t: t.replace("Lobatto", "Gauss")),
            ss.StaleKernelError,
            "does not match the digest",
        ),
        (lambda d: with_module(d, hostile), ss.StaleKernelError, "no generated module has"),
        (lambda d: with_module(d, lambda t: "print(1)"), ss.StaleKernelError, "no module"),
        (lambda d: with_module(d, lambda t: resigned(t, "\n)(")), ss.StaleKernelError, "no Python"),
    ],
)
def test_files_that_were_edited(tmp_path, monkeypatch, change, error, message):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "run.nc"
    run_of("double_pendulum", "simpson").save(path)
    changed(path, change)
    with pytest.raises(error, match=message):
        ss.open_trajectory(path)
    assert not (tmp_path / "canary").exists()


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["nc", "zarr"])
def test_damaged_files_raise_what_they_should(tmp_path, ending):
    run = run_of("double_pendulum", "simpson")
    whole = tmp_path / f"whole.{ending}"
    run.save(whole)
    draw = random.Random(5)
    for k in range(60):
        path = tmp_path / f"damaged_{k}.{ending}"
        (shutil.copy if ending == "nc" else shutil.copytree)(whole, path)
        files = [path] if ending == "nc" else sorted(x for x in path.rglob("*") if x.is_file())
        victim = draw.choice(files)
        content = bytearray(victim.read_bytes())
        if k % 3 == 0:
            content = content[: draw.randrange(len(content))]
        else:
            content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
        victim.write_bytes(content)
        try:
            found = ss.open_trajectory(path)
        except ss.SymsimpsonError:
            continue
        assert (found.y == run.y).all()  # what was damaged is of no consequence
        assert found.program.source == run.program.source


@pytest.mark.parametrize("ending", ["nc", "zarr"])
def test_derivatives_are_saved_with_a_run(tmp_path, ending):
    system = ss.systems.double_pendulum()
    run = ss.compile(system).integrate(
        **system.reference_state, h=0.01, steps=30, every=3, tangents=4, sensitivities=["m1", "g"]
    )
    run.save(tmp_path / f"run.{ending}")
    opened = ss.open_trajectory(tmp_path / f"run.{ending}")
    assert np.array_equal(opened.tangent, run.tangent)
    assert list(opened.sensitivity) == ["m1", "g"]
    for name in run.sensitivity:
        assert np.array_equal(opened.sensitivity[name], run.sensitivity[name])


def test_a_folder_that_cannot_be_written_whole_is_not_there(tmp_path, monkeypatch):
    """Nor is what was there before lost."""
    run = run_of("double_pendulum", "simpson")
    path = tmp_path / "run.zarr"
    plain = xarray.Dataset.to_zarr

    def fail(self, where, **options):
        plain(self, where, **options)
        raise OSError("no space left")

    for before in (False, True):
        if before:
            run.save(path)
        with monkeypatch.context() as broken:
            broken.setattr(xarray.Dataset, "to_zarr", fail)
            with pytest.raises(ss.StorageError, match="no space left"):
                run.save(path)
        assert [one.name for one in tmp_path.iterdir()] == ["run.zarr"] * before
    assert np.array_equal(ss.open_trajectory(path).q, run.q)
