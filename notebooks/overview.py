"""Draw overview.png, the figure of the README: python overview.py."""

import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import symsimpson as ss
from symsimpson.reference import canonical, rk4

HERE = Path(__file__).parent
plt.style.use("symsimpson.plotting.book")


def main() -> None:
    """Draw three panels: a path, what becomes of the energy, and steps that adapt."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(10, 3.1))

    pendulum = ss.systems.double_pendulum()
    q0, p0 = [2.0, 2.2], [0.0, 0.0]
    stepper = ss.compile(pendulum, "gauss8")
    run = stepper.integrate(q0, p0=p0, h=0.01, t_end=20.0)
    path = run.at(np.linspace(0.0, 20.0, 6000))
    x = 0.25 * (np.sin(path["q1"]) + np.sin(path["q2"]))
    height = -0.25 * (np.cos(path["q1"]) + np.cos(path["q2"]))
    left.plot(x, height, lw=0.5)
    left.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title="double pendulum, the lower bob")

    simpson = ss.compile(pendulum, "simpson")
    long = simpson.integrate([0.8, 1.0], p0=p0, h=0.02, t_end=2000.0, every=10)
    _, y = rk4(canonical(pendulum), [0.8, 1.0, 0.0, 0.0], h=0.02, steps=100_000, every=10)
    H = simpson.energy(y[:, :2], y[:, 2:4])
    middle.semilogy(long.t[1:], np.abs((H - H[0]) / H[0])[1:], color="C1", label="RK4")
    middle.semilogy(long.t[1:], np.abs(long.energy_error)[1:], color="C0", lw=0.6, label="Simpson")
    middle.set(xlabel="t [s]", ylabel="relative energy error", title="equal steps, 2000 s")
    middle.legend(loc="center", bbox_to_anchor=(0.55, 0.68), ncols=2)

    three = ss.systems.pythagorean()
    adapting = ss.compile(three.retimed("encounters"), "gauss16")
    met = adapting.integrate(**three.reference_state, h=0.2, t_end=62.0)
    paths = met.at(np.linspace(0.0, 62.0, 20_000))
    for body in range(3):
        right.plot(paths[f"x{body}"], paths[f"y{body}"], lw=0.5)
    right.set(xlim=(-4, 4), ylim=(-4, 4), aspect="equal", xlabel="x", ylabel="y",
              title=f"three bodies meet, {met.steps} steps")  # fmt: skip
    figure.savefig(HERE / "overview.png")
    draw_ten_lines()


def draw_ten_lines() -> None:
    """Draw the figure of the first example of the book: run it as it is printed there."""
    page = (HERE / "index.md").read_text("utf-8")
    code = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    assert code is not None
    names: dict[str, object] = {}
    exec(code[1], names)
    plt.gcf().savefig(HERE / "ten_lines.png")


if __name__ == "__main__":
    main()
