"""What is installed: the wheel and the source distribution, and the core by itself."""

import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile

import pytest
from support.places import ROOT


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-d", str(folder)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    return folder


def test_the_wheel_holds_the_package_and_nothing_else(built):
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as opened:
        names = set(opened.namelist())
        about = next(x for x in names if x.endswith("METADATA"))
        metadata = opened.read(about).decode()
    assert {x.split("/")[0].split("-")[0] for x in names} == {"symsimpson"}
    assert "License-Expression: BSD-3-Clause" in metadata
    assert any(x.endswith("licenses/LICENSE") for x in names)
    assert not any("changes" in x.lower() for x in names)
    present = {str(x.relative_to(ROOT)) for x in (ROOT / "symsimpson").rglob("*.py")}
    others = {"py.typed", "__init__.pyi", "plotting/book.mplstyle", "targets/c/step.c"}
    assert present | {f"symsimpson/{x}" for x in others} <= names
    for extra in ("plot", "data", "bench", "cluster", "precise", "notebooks", "progress"):
        assert f"Provides-Extra: {extra}" in metadata


def test_the_source_distribution_has_the_tests(built):
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        names = {"/".join(x.split("/")[1:]) for x in opened.getnames()}
    assert {
        "README.md",
        "LICENSE",
        "CITATION.cff",
        "pyproject.toml",
        "generated/pendulum__simpson.py",
        "symsimpson/py.typed",
        "tests/pages/test_packaging.py",
    } <= names


def test_the_core_needs_five_packages():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    needed = {x.split(">")[0] for x in project["dependencies"]}
    assert needed == {"sympy", "numpy", "numba", "mpmath", "lazy_loader", "filelock"}


def test_versions_agree():
    import symsimpson as ss

    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert project["version"] == ss.__version__
    citation = (ROOT / "CITATION.cff").read_text("utf-8")
    changes = (ROOT / "notebooks/contributing/changes.md").read_text("utf-8")
    versions = re.findall(r"^## (\S+) \((\d{4}-\d\d-\d\d|unreleased)\)$", changes, re.M)
    released = next(version for version, date in versions if date != "unreleased")
    # the citation is that of the last release; between releases the version is one of development
    assert f"version: {released}\ndate-released: {dict(versions)[released]}\n" in citation
    newest, date = versions[0]
    assert ss.__version__ == (f"{newest}.dev0" if date == "unreleased" else newest)
    needed = project["optional-dependencies"]["test-all"]
    pinned = dict(x.split("==") for x in needed if "==" in x)
    hooks = (ROOT / ".pre-commit-config.yaml").read_text("utf-8")
    assert f"rev: v{pinned['ruff']} " in hooks


def test_the_workflow_runs_the_lines_of_the_readme():
    """Those behind the two comments, on what the classifiers of the package name."""
    yaml = pytest.importorskip("yaml")
    flow = yaml.safe_load((ROOT / ".github/workflows/tests.yml").read_text("utf-8"))
    text = (ROOT / "README.md").read_text("utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    for job in ("first-line", "test-line"):
        found = re.search(rf"<!-- {job.replace('-', ' ')} -->\n```sh\n(python3 .*)\n", text)
        assert found
        steps = flow["jobs"][job]["steps"]
        assert f"<!-- {job.replace('-', ' ')} -->" in steps[-1]["run"]
        versions = flow["jobs"][job]["strategy"]["matrix"]["python"]
        told = [f"Programming Language :: Python :: {x}" for x in versions]
        assert set(told) <= set(project["classifiers"])
    for path in (ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml"):
        assert yaml.safe_load(path.read_text("utf-8"))["body"]


@pytest.mark.parametrize(
    ("library", "use", "extra"),
    [
        ("matplotlib.pyplot", "run.plot()", "plot"),
        ("xarray", "run.to_xarray()", "data"),
        ("pandas", "run.to_pandas()", "data"),
        ("netCDF4", "run.save('run.nc')", "data"),
        ("plotly.graph_objects", "top.animate()._repr_html_()", "plot"),
        (
            "tqdm.auto",
            "stepper.integrate([1.0], v0=[0.0], h=0.1, steps=9, progress=True)",
            "progress",
        ),
        ("flint", "ss.compile(ss.systems.pendulum(), precision=30, arithmetic='arb')", "precise"),
    ],
)
def test_a_missing_extra_is_named(library, use, extra, monkeypatch, tmp_path):
    import symsimpson as ss

    monkeypatch.chdir(tmp_path)
    stepper = ss.compile(ss.systems.pendulum())
    names = {
        "ss": ss,
        "stepper": stepper,
        "run": stepper.integrate([1.0], v0=[0.0], h=0.1, steps=9),
    }
    if extra == "plot":
        top = ss.compile(ss.systems.lagrange_top())
        names["top"] = top.integrate(**top.reference_state, h=0.001, steps=9)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ss.InputError, match=rf"pip install 'symsimpson\[{extra}\]'"):
        eval(use, names)


def test_every_public_name_is_there():
    import symsimpson as ss

    assert len(set(ss.__all__)) > 40
    for name in ss.__all__:
        assert getattr(ss, name) is not None
        assert name in dir(ss)
    with pytest.raises(AttributeError, match="nothing"):
        _ = ss.nothing


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """A fresh one; what the package needs is in it from the first time that it is installed."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    return folder / "bin"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["*.whl", "*.tar.gz"])
def test_what_is_built_runs_in_a_fresh_environment(built, environment, kind, tmp_path):
    (package,) = built.glob(kind)
    pip = [environment / "python", "-m", "pip", "-q"]
    subprocess.run([*pip, "uninstall", "-y", "symsimpson"], check=True)
    subprocess.run([*pip, "install", str(package)], check=True)
    command = [environment / "symsimpson", "run", "lagrange_top", "--t-end", "1"]
    found = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert "100 steps to t = 1" in found.stdout
