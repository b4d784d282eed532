"""A rig in pictures: MuJoCo's renderer where it works without a screen, matplotlib elsewhere."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from tepm_opt.hw.simulation.mujoco_network import MujocoNetwork
from tepm_opt.hw.simulation.rig import SimulatedRig


class RigView:
    """Pictures of a simulated rig as it is at its last sample.

    Args:
        rig: to look at.
        width, height: of the picture in pixels, at most 1280 and 960.
        plain: use matplotlib, whether MuJoCo can render here or not.

    Attributes:
        method: "mujoco" or "matplotlib": what draws.
    """

    def __init__(self, rig: SimulatedRig, width: int = 640, height: int = 480, plain: bool = False) -> None:
        self.rig, self.width, self.height = rig, width, height
        self._offscreen = None if plain else _offscreen(rig)  # MuJoCo's network only draws: whichever engine moves the rig
        self.method = "matplotlib" if self._offscreen is None else "mujoco"

    def image(self, azimuth: float = 60.0) -> np.ndarray:
        """The picture as seen by an eye at an azimuth in degrees about z, (height, width, 3), uint8."""
        if self._offscreen is None:
            return _drawn(self.rig, self.width, self.height, azimuth)
        return self._rendered(azimuth, *self._offscreen)

    def _rendered(self, azimuth: float, network: MujocoNetwork, scene: Any, context: Any) -> np.ndarray:
        import mujoco

        _screen().make_current()
        reach = self._reach
        camera: Any = mujoco.MjvCamera()  # type: ignore[attr-defined]
        camera.lookat[:] = (0, 0, reach / 2)
        camera.distance, camera.azimuth, camera.elevation = 1.6 * reach, azimuth + 180.0, -12.0
        network.place(((self.rig.true_nodes - network.base) @ network.turn - network.rest)[1:].ravel())
        mujoco.mjv_updateScene(network.model, network.data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)  # type: ignore[attr-defined]
        area: Any = mujoco.MjrRect(0, 0, self.width, self.height)  # type: ignore[attr-defined]
        mujoco.mjr_render(area, scene, context)  # type: ignore[attr-defined]
        pixels = np.empty((self.height, self.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, area, context)  # type: ignore[attr-defined]
        return pixels[::-1].copy()

    @property
    def _reach(self) -> float:
        return 1.3 * self.rig.robot.modules * self.rig.robot.parameters.L_0


@cache
def _screen() -> Any:
    """One OpenGL context for all views (those of freed views would take the others' buffers with them); None where there is no EGL."""
    try:
        from mujoco.egl import GLContext  # type: ignore[import-not-found]

        return GLContext(64, 64)  # MuJoCo draws into buffers of its own
    except Exception:  # whatever is missing or broken in a driver: there is the other way to draw
        return None


def _offscreen(rig: SimulatedRig) -> tuple[MujocoNetwork, Any, Any] | None:
    """A network of MuJoCo's to be drawn, scene and renderer; None where it cannot render."""
    if _screen() is None:
        return None
    import mujoco

    try:
        _screen().make_current()
        network = MujocoNetwork(rig.machine.body, rig.machine.step)
        scene = mujoco.MjvScene(network.model, maxgeom=20 * network.model.ntendon + 1000)  # type: ignore[attr-defined]
        context: Any = mujoco.MjrContext(network.model, mujoco.mjtFontScale.mjFONTSCALE_100)  # type: ignore[attr-defined]
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)  # type: ignore[attr-defined]
    except (mujoco.FatalError, RuntimeError):  # type: ignore[attr-defined]
        return None
    return network, scene, context


def _drawn(rig: SimulatedRig, width: int, height: int, azimuth: float) -> np.ndarray:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes: Any = figure.add_subplot(projection="3d")
    nodes, points = rig.true_nodes, rig.true_points
    for level in nodes:
        axes.plot(*np.vstack([level, level[:1]]).T, color="0.6", lw=1)
    for muscle in nodes.swapaxes(0, 1):
        axes.plot(*muscle.T, color="tab:blue", lw=3)
    axes.plot(*points.T, "o", color="tab:red")
    reach = 1.3 * rig.robot.modules * rig.robot.parameters.L_0 / 2
    middle = nodes[0].mean(axis=0) + np.array([0, 0, reach])
    for axis, centre in zip("xyz", middle, strict=True):
        getattr(axes, f"set_{axis}lim")(centre - reach, centre + reach)
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(elev=12, azim=azimuth)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
