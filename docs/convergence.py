"""Print the convergence table of docs/results/convergence.md: how results depend on the number of segments n_e.

Run: python docs/convergence.py
"""

from __future__ import annotations

import numpy as np

from tepm_opt import Model, Robot, compile_model, load_robot, poles, solve_statics

SEGMENTS = (2, 3, 4, 6, 8, 10, 12, 24)


def row(robot: Robot) -> list[str]:
    """Elongation, tilt under a side force, tip of a bend, stability and sway of one robot, as text."""
    model = compile_model(Model(robot))
    elongated = solve_statics(model, [0.2e6] * 3 + [0.3e6] * 3 + [0.0] * 6)
    loaded = solve_statics(model, np.zeros(12), [2.5, 0.0, 0.0])
    bent = solve_statics(model, [0.15e6, 0, 0, 0.15e6, 0, 0, 0, 3, 3, 0, 3, 3])
    rest = solve_statics(model, np.zeros(12))
    sway = poles(rest)[0]
    numbers = [
        f"{1e3 * (elongated.tip[2] - rest.tip[2]):.2f}",
        f"{np.rad2deg(loaded.tip_tilt):.2f}",
        f"{1e3 * bent.tip[1]:.1f}, {1e3 * bent.tip[2]:.1f}",
        f"{rest.smallest_eigenvalue:.4f}",
        f"{abs(sway.imag) / (2 * np.pi):.3f}",
        f"{-sway.real / abs(sway):.3f}",
    ]
    return [str(robot.geometry.segments_per_module), *numbers]


def main() -> None:
    """Print the table as Markdown."""
    head = ["n_e", "elongation mm", "tilt under 2.5 N °", "bend: tip y, z mm", "smallest stiffness N/m", "sway Hz", "damping ratio"]
    print("| " + " | ".join(head) + " |\n|" + " --- |" * len(head))
    nominal = load_robot("kang2017")
    for count in SEGMENTS:
        geometry = nominal.geometry.model_copy(update={"segments_per_module": count})
        print("| " + " | ".join(row(nominal.model_copy(update={"geometry": geometry}))) + " |", flush=True)


if __name__ == "__main__":
    main()
