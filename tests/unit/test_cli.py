"""The command line: what it prints, writes and gives back."""

import subprocess
import sys

import numpy as np
import pytest
import sympy as sp
from support.places import GENERATED

import symsimpson as ss
from symsimpson.cli import main
from symsimpson.cli.commands import find

OWN = """
import symsimpson as ss
(x,) = ss.coordinates("x")
spring = ss.MechanicalSystem("own_spring", coordinates=(x,), kinetic=x.diff()**2/2,
                             potential=x**4, parameters={})
number = 3
def make():
    return spring
def needs(x):
    return spring
"""


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "model.py"
    path.write_text(OWN)
    return path


@pytest.mark.slow
def test_list(capsys):
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in (*ss.systems.CATALOGUE, *ss.systems.MODELS))


def test_a_robot_from_its_file(tmp_path, capsys):
    """Its joints, a run without inputs, and what is wrong."""
    file = tmp_path / "swing.urdf"
    file.write_text(
        '<robot name="swing"><link name="base"/><link name="bar"><inertial>'
        '<origin xyz="0 0 -1"/><mass value="2"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
        '</link><joint name="hinge" type="continuous"><parent link="base"/><child link="bar"/>'
        '<axis xyz="0 1 0"/></joint></robot>'
    )
    assert main(["list", str(file)]) == 0
    assert "hinge  continuous" in capsys.readouterr().out
    assert main(["run", str(file), "--t-end", "1"]) == 0
    assert "100 steps to t = 1" in capsys.readouterr().out
    assert main(["list", "pendulum"]) == 1
    assert "not a robot" in capsys.readouterr().err
    file.write_text("<robot><link/></robot>")
    assert main(["run", str(file)]) == 1
    assert "line 1, <link>: it has no attribute 'name'" in capsys.readouterr().err


def test_generate(tmp_path, own, capsys):
    target = tmp_path / "out"
    for system in ("pendulum", f"{own}:spring", f"{own}:make"):
        assert main(["generate", system, "--scheme", "gauss4", "--directory", str(target)]) == 0
    names = sorted(path.name for path in target.iterdir())
    assert names == ["own_spring__gauss4.py", "pendulum__gauss4.py"]
    assert str(target / names[0]) in capsys.readouterr().out
    assert ss.load(target / names[0]).order == 4


PROJECT = """
import argparse, sys
from dataclasses import dataclass
import symsimpson as ss
from constants_of_mine import STIFFNESS

@dataclass
class Spring:
    stiffness: "float"

argparse.ArgumentParser().parse_args()
(x,) = ss.coordinates("x")

def spring():
    from lengths_of_mine import LENGTH
    return ss.MechanicalSystem("own", coordinates=(x,), kinetic=x.diff()**2/2, parameters={},
                               potential=Spring(STIFFNESS).stiffness * (x - LENGTH)**2)

if __name__ == "__main__":
    raise ValueError("this is no script")
sys.exit(CODE)
"""


def project(folder, stiffness=2, code=0):
    folder.mkdir()
    (folder / "constants_of_mine.py").write_text(f"STIFFNESS = {stiffness}")
    (folder / "lengths_of_mine.py").write_text(f"LENGTH = {stiffness + 1}")
    (folder / "model.py").write_text(PROJECT.replace("CODE", str(code)))
    return f"{folder}/model.py:spring"


def test_a_file_runs_as_python_runs_it(tmp_path):
    """It imports its neighbours, those of its own folder; it has no arguments, and may exit."""
    before = list(sys.path), sys.argv
    for stiffness in (2, 5):
        system = find(project(tmp_path / f"of {stiffness}", stiffness))
        (x,) = system.coordinates
        assert sp.expand(system.potential - stiffness * (x - stiffness - 1) ** 2) == 0
    assert (sys.path, sys.argv) == before
    with pytest.raises(ss.InputError, match=r"it calls sys.exit\(3\)"):
        find(project(tmp_path / "failing", code=3))


@pytest.mark.slow
def test_a_file_that_exits_is_run(tmp_path, capsys):
    command = ["run", project(tmp_path / "own"), "--q0", "1", "--v0", "0", "--steps", "3"]
    assert main(command) == 0
    assert "3 steps to t" in capsys.readouterr().out


@pytest.mark.slow
def test_a_step_that_does_not_divide_the_time(capsys):
    assert main(["run", "pendulum", "--h", "0.3", "--t-end", "1"]) == 0
    assert (
        "The step size is h=0.25, not 0.3, so that 4 steps end at t_end." in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("command", "meant"),
    [(["rum", "pendulum"], "run"), (["plot", "pendulum", "--out", "a", "--kind", "tim"], "time")],
)
def test_wrong_commands_are_asked_about(command, meant, capsys):
    with pytest.raises(SystemExit):
        main(command)
    assert f"Did you mean {meant}?" in capsys.readouterr().err


def test_completion_without_its_library(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["--print-completion", "bash"]) == 1
    assert "completion needs shtab, which is not installed" in capsys.readouterr().err


def test_what_is_told_of_a_run_does_not_depend_on_the_states_that_it_stores(capsys):
    told, asked = [], ["run", "damped_pendulum", "--h", "0.01", "--steps", "150", "--every"]
    for every in ("1", "70"):
        assert main([*asked, every]) == 0
        told.append(capsys.readouterr().out.splitlines())
    whole, few = told
    assert whole[-2] == few[-2]
    assert whole[-2].startswith("  energy")
    *_, rough = (float(lines[-3].split(", ")[1].split()[0]) for lines in told)
    assert rough > 1.1  # of the 140 steps up to the last stored state
    assert main([*asked, "151"]) == 0
    assert "Newton" not in capsys.readouterr().out


@pytest.mark.slow
def test_check(tmp_path, capsys):
    from shutil import copytree

    target = tmp_path / "generated"
    copytree(GENERATED, target)
    assert main(["check", "--directory", str(target)]) == 0
    (target / "kepler__simpson.py").unlink()
    (target / "other.py").write_text("")
    with (target / "pendulum__simpson.py").open("a") as file:
        file.write("\n")
    assert main(["check", "--directory", str(target)]) == 1
    out = capsys.readouterr().out
    assert "missing  kepler__simpson.py" in out
    assert "other    other.py, which is not in the catalogue" in out
    assert "stale    pendulum__simpson.py" in out


def test_run(tmp_path, own, capsys):
    files = [tmp_path / "run.npz", tmp_path / "run.csv"]
    for file in files:
        arguments = ["run", f"{own}:spring", "--q0", "1", "--v0", "0.5", "--steps", "20"]
        assert main([*arguments, "--h", "0.05", "--out", str(file)]) == 0
    out = capsys.readouterr().out
    assert "own_spring, simpson (order 4), h = 0.05" in out
    assert "20 steps to t = 1" in out
    assert "energy error" in out
    stored = np.load(files[0], allow_pickle=False)
    table = np.loadtxt(files[1], delimiter=",", skiprows=1)
    assert files[1].read_text().splitlines()[0] == "t,x,p_x,v_x,energy,kinetic_energy"
    assert (
        table == np.column_stack([stored[k] for k in (*"tqpv", "energy", "kinetic_energy")])
    ).all()


ERRORS = {
    "unknown system": (["run", "nothing"], "the catalogue has no system 'nothing'"),
    "no such file": (["run", "nothing.py:x"], "there is no file nothing.py"),
    "no system": (["run", "{own}:number"], "is not a MechanicalSystem"),
    "a function with arguments": (["run", "{own}:needs"], "needs() returns no system: TypeError"),
    "no state": (["run", "{own}:spring"], "no reference state"),
    "scheme": (["run", "pendulum", "--scheme", "euler"], "no scheme 'euler'"),
    "format": (["run", "pendulum", "--out", "run.xls"], "unsupported file extension '.xls'"),
    "step": (["run", "pendulum", "--h", "0"], "the step size h is 0"),
    "directory": (["generate", "pendulum", "--directory", "{own}"], "cannot be written"),
    "both ends": (["run", "pendulum", "--t-end", "1", "--steps", "5"], "exactly one of"),
    "far away": (["run", "pendulum", "--t-end", "1e308"], "is too long; the limit is"),
    "velocity alone": (["run", "pendulum", "--v0", "1"], "--v0 without --q0"),
    "position alone": (["run", "pendulum", "--q0", "1"], "exactly one of --v0 and --p0"),
    "three of a plane": (
        ["plot", "pendulum", "theta", "v_theta", "zz", "--kind", "phase", "--out", "run.png"],
        "--kind phase plots two quantities, not theta, v_theta, zz",
    ),
    "a module": (["export", "{own}", "--out", "own"], "Name the variable that has the system"),
    "names of energies": (
        ["plot", "pendulum", "theta", "--kind", "energy", "--out", "run.png"],
        "--kind energy does not plot theta",
    ),
}


@pytest.mark.parametrize(("arguments", "message"), ERRORS.values(), ids=ERRORS)
def test_errors(arguments, message, own, capsys):
    assert main([argument.format(own=own) for argument in arguments]) == 1
    captured = capsys.readouterr()
    assert captured.err.count(message) == 1
    assert "Traceback" not in captured.err


def test_a_failing_run_says_why(capsys):
    arguments = [
        "run",
        "double_pendulum",
        "--q0",
        "2.5,2",
        "--v0",
        "0,9",
        "--h",
        "2",
        "--steps",
        "50",
    ]
    assert main(arguments) == 1
    assert "ConvergenceError: double_pendulum, simpson: step" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["list", "generate", "check", "run", "bench"])
def test_help(command, capsys):
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    assert "usage: symsimpson" in capsys.readouterr().out


@pytest.mark.slow
def test_module_is_a_command():
    done = subprocess.run(
        [sys.executable, "-m", "symsimpson", "run", "nothing"], capture_output=True, text=True
    )
    assert done.returncode == 1
    assert done.stderr.startswith("InputError: the catalogue has no system 'nothing'")


def test_values_that_begin_with_a_minus(capsys):
    given = ["--q0", "-0.8,1.0", "--v0", "-.5,0", "--steps", "1e1"]
    assert main(["run", "double_pendulum", *given]) == 0
    said = capsys.readouterr().out
    assert "q0 = (-0.8, 1)" in said
    assert "v0 = (-0.5, 0)" in said
    assert "10 steps" in said


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("stress pendulum --steps -5", "not a positive whole number"),
        ("run pendulum --q0 a", "not a list of numb"),
        ("run pendulum --steps 1.5", "not a positive whole number"),
        ("run pendulum --steps many", "not a positive whole"),
        ("export pendulum --h 0.1 --out x", "no option --h.\nsymsimpson export takes --scheme"),
        ("run pendulum --shceme midpoint", "no option --shceme. Did you mean --scheme?"),
    ],
)
def test_wrong_values_are_named(line, said, capsys):
    with pytest.raises(SystemExit) as caught:
        main(line.split())
    assert caught.value.code == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--plot", "--out"])
def test_formats_are_looked_at_before_anything_is_measured(option, capsys):
    assert main(["bench", "pendulum", option, "x.xyz"]) == 1
    assert "unknown format" in capsys.readouterr().err


def test_version(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out.startswith("symsimpson ")


def test_warnings_are_told_in_words_and_once(capsys):
    assert main(["run", "double_pendulum", "--h", "0.5", "--t-end", "10"]) == 1
    said = capsys.readouterr().err
    assert said.count("StabilityWarning: double_pendulum, simpson: h=0.5 exceeds") == 1
    assert ".py:" not in said
    assert "step 0 of 1 " not in said


def test_a_table_that_cannot_be_written_is_told_before_the_run(tmp_path, capsys):
    out = tmp_path / "missing" / "run.csv"
    assert main(["run", "pendulum", "--h", "0.01", "--steps", "5", "--out", str(out)]) == 1
    said = capsys.readouterr()
    assert "there is no folder" in said.err
    assert said.out == ""


@pytest.mark.slow
def test_steps_that_adapt(capsys):
    asked = ["run", "kepler_plane", "--retimed", "encounters", "--scheme", "gauss8", "--h", "0.5"]
    assert main([*asked, "--t-end", "20"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("kepler_plane_retimed, gauss8")
    assert "to t = 20" in out
    assert main(["run", "pendulum", "--retimed", "encounters"]) == 1
    assert "is not a sum of" in capsys.readouterr().err


def test_parameters_and_inputs(tmp_path, capsys):
    assert main(["run", "pendulum", "--set", "l=4", "--set", "g=9", "--steps", "5"]) == 0
    assert "  l = 4\n  g = 9\n" in capsys.readouterr().out
    rows = np.linspace(-1, 1, 8)
    path, out = tmp_path / "pushes.csv", tmp_path / "run.npz"
    path.write_text("u\n" + "\n".join(map(repr, rows.tolist())))
    asked = ["run", "driven_cart_pole", "--inputs", str(path), "--out", str(out)]
    assert main([*asked, "--steps", "8"]) == 0
    system = ss.systems.driven_cart_pole()
    (name,) = ss.compile(system).inputs
    run = ss.compile(system).integrate(
        **system.reference_state, h=0.01, steps=8, inputs={name: rows}
    )
    with np.load(out) as found:
        assert np.array_equal(found["q"], run.q)
    assert main([*asked, "--steps", "9"]) == 1
    assert "has 8 rows for 9 steps" in capsys.readouterr().err
    assert main(["run", "driven_cart_pole", "--steps", "9"]) == 1
    told = capsys.readouterr().err
    assert "--inputs is missing: driven_cart_pole has the inputs u.\n" in told
    assert "Pass --inputs FILE" in told
    assert "next 9 lines" in told
    path.write_text("v\n1\n2\n")
    assert main([*asked, "--steps", "2"]) == 1
    assert "the columns are v. The inputs of driven_cart_pole are u" in capsys.readouterr().err
    path.write_bytes(b"\xef\xbb\xbfu\r\n1\r\n2\r\n")  # as spreadsheets write them
    assert main([*asked, "--steps", "2"]) == 0
    path.write_text("")
    assert main([*asked, "--steps", "2"]) == 1
    assert "the file cannot be read" in capsys.readouterr().err
    assert main(["run", "pendulum", "--h", "0.1", "--steps", "5", "--every", "2"]) == 0
    assert "5 steps to t = 0.5," in capsys.readouterr().out


@pytest.mark.parametrize("given", ["l", "l=", "=3", "l=a"])
def test_values_of_parameters_are_read(given, capsys):
    with pytest.raises(SystemExit):
        main(["run", "pendulum", "--set", given])
    assert "is not a parameter with a value like R=0.4" in capsys.readouterr().err


def test_an_unknown_parameter_is_named(capsys):
    assert main(["run", "pendulum", "--set", "lenght=2"]) == 1
    assert "lenght" in capsys.readouterr().err


@pytest.mark.parametrize("behind", [0, 1, 2])
def test_names_may_stand_behind_options(behind, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr("symsimpson.cli.commands.plot", lambda options: drawn.append(options) or 0)
    names, out = ["q1", "energy"], ["--out", str(tmp_path / "run.png")]
    first = len(names) - behind
    assert main(["plot", "double_pendulum", *names[:first], *out, *names[first:]]) == 0
    assert drawn[0].names == names
    for wrong in (["run", "pendulum", "q1"], ["plot", "pendulum", *out, "--nothing", "q1"]):
        with pytest.raises(SystemExit):
            main(wrong)


@pytest.mark.slow
def test_figures_and_films(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    asked = ["double_pendulum", "--steps", "50"]
    for kind in ("time", "phase", "energy", "path"):
        out = tmp_path / f"{kind}.png"
        assert main(["plot", *asked, "--kind", kind, "--out", str(out)]) == 0
        assert out.read_bytes().startswith(b"\x89PNG")
    out = tmp_path / "film.gif"
    assert main(["film", *asked, "--seconds", "1", "--fps", "3", "--out", str(out)]) == 0
    assert out.read_bytes().startswith(b"GIF89a")
    assert str(out) in capsys.readouterr().out
    assert main(["plot", *asked, "--out", "run.jpeg"]) == 1
    assert "unknown format" in capsys.readouterr().err


@pytest.mark.slow
def test_a_scheme_and_a_step_are_chosen(capsys):
    assert main(["choose", "pendulum", "--t-end", "2", "--error", "1e-5"]) == 0
    assert "with h = " in capsys.readouterr().out


@pytest.mark.slow
def test_check_elsewhere_is_told_what_it_is_for(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hoop__simpson.py").write_text("")
    for arguments in (["check"], ["check", "--directory", "."]):
        assert main(arguments) == 1
        said = capsys.readouterr()
        assert "run it in a clone of the repository" in said.err
        assert "delete" not in said.out + said.err


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion(shell, capsys):
    pytest.importorskip("shtab")
    with pytest.raises(SystemExit) as caught:
        main(["--print-completion", shell])
    assert caught.value.code == 0
    out = capsys.readouterr().out
    assert all(word in out for word in ("certify", "--t-end", "--set"))
