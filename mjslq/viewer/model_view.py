"""A model in a browser, before there is any motion: keyframes, a slider for each joint, and what touches in that pose.

    mjslq view robot.xml

The pose can be taken over into a task file: the panel shows it as `positions = { ... }`.
"""

from __future__ import annotations

import html
from typing import Any

import mujoco
import numpy as np
import viser

from mjslq.dynamics.mujoco.contacts import model_of_scene
from mjslq.dynamics.mujoco.engine import MujocoDynamics
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, choose
from mjslq.viewer.look import Look
from mjslq.viewer.scene import SceneView, quiet
from mjslq.viewer.serving import Served, present

TURN, SLIDE = np.pi, 1.0
"""Ends of the sliders of joints without a range. [rad], [m]"""
_TOUCHES = 4
_NOTE = '<div style="font-size:12px;line-height:1.55;padding:2px 10px 8px;overflow-wrap:anywhere">{}</div>'
_REFERENCE = "(reference)"


class ModelView(Served):
    """A Viser server that shows one model; a context manager, or `start` and `stop`."""

    def __init__(
        self, dynamics: MujocoDynamics, host: str = "127.0.0.1", port: int = 8080, *, dark: bool = False
    ) -> None:
        """Prepare to show the model of `dynamics` at `host`:`port`, or at the next free port."""
        self._dark = bool(dark)
        super().__init__(host, port)
        self._dynamics = dynamics
        self._scene = dynamics.scene()
        self._model = model_of_scene(self._scene.model)
        self._data = mujoco.MjData(self._model)
        self._x = dynamics.initial_state
        self._view: SceneView | None = None
        self.sliders: dict[str, Any] = {}
        """The slider of each joint with one axis, by the joint's name."""
        self._note: Any = None

    @property
    def x(self) -> Array:
        """The state that is shown. Shape (nx,)."""
        return self._x.copy()

    @property
    def touching(self) -> list[str]:
        """What touches in this pose, the deepest first: "hand and floor, 2.1 mm"."""
        model, data = self._model, self._data
        data.qpos[:] = self._scene.poses(self._x[None])[0]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        found = sorted((float(contact.dist), contact.geom.tolist()) for contact in data.contact[: data.ncon])
        return [f"{self._geom(a)} and {self._geom(b)}, {-1e3 * dist:.1f} mm" for dist, (a, b) in found if dist <= 0.0]

    def start(self) -> None:
        """Open the server; does nothing when running."""
        with self._lock:
            if self._server is not None:
                return
            server = self._open()
            try:
                self._view = SceneView(
                    server, self._scene, self._standing(), 0.85, dark=self._dark, contact=self._dynamics.contact
                )
                self._view.set_trace(False)
                self._build(server.gui)
            except BaseException:
                self.stop()
                raise

    def stop(self) -> None:
        """Close the server; does nothing when not running."""
        self._ended.set()
        with self._lock:
            server, self._server, self._view = self._server, None, None
            self.sliders = {}
        if server is not None:
            with quiet():
                server.stop()

    def show(self, x: Array) -> None:
        """Show a state (nx,), sliders included."""
        with self._lock:
            self._x = np.array(self._dynamics.checked_start(x))
            for name, slider in self.sliders.items():
                slider.value = float(np.clip(self._x[self._entry(name)], slider.min, slider.max))
            self._refresh()

    def move(self, joint: str, position: float) -> None:
        """Put a joint at a position. [rad or m]"""
        choose("joint with one axis", joint, self._joints())
        x = self.x
        x[self._entry(joint)] = position
        self.show(x)

    def _build(self, gui: viser.GuiApi) -> None:
        gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=self._dark)
        gui.main_panel.dock_right()
        gui.set_panel_label("mjslq")
        with gui.add_folder(self._dynamics.name):
            names = self._dynamics.keyframe_names
            if names:
                keyframes = gui.add_dropdown("Keyframe", (_REFERENCE, *names), initial_value=_REFERENCE)
                keyframes.on_update(lambda event: self._chosen(event))
            self._note = gui.add_html("")
        assert self._view is not None
        Look(gui, self._view, skip=("traces",))
        with gui.add_folder("Joints"):
            for name in self._joints():
                low, high = self._range(name)
                value = float(np.clip(self._x[self._entry(name)], low, high))
                slider = gui.add_slider(name, low, high, (high - low) / 500.0, value)
                slider.on_update(self._mover(name))
                self.sliders[name] = slider
        self._refresh()

    def _chosen(self, event: Any) -> None:
        if event.client_id is not None:
            name = event.target.value
            self.show(self._dynamics.initial_state if name == _REFERENCE else self._dynamics.keyframe(name))

    def _mover(self, name: str) -> Any:
        def moved(event: Any) -> None:
            if event.client_id is not None:  # set from Python otherwise
                self.move(name, float(event.target.value))

        return moved

    def _refresh(self) -> None:
        if self._view is None:
            return
        self._view.follow(self._view.motion(self._standing()))
        self._view.show(0.0)
        touching = self.touching
        lines = [html.escape(line) for line in touching[:_TOUCHES]]
        if len(touching) > _TOUCHES:
            lines.append(f"and {len(touching) - _TOUCHES} more")
        said = "<br>".join(lines) if lines else "Nothing touches."
        self._note.content = _NOTE.format(f"{said}<br><code>positions = {html.escape(self.positions)}</code>")

    @property
    def positions(self) -> str:
        """The pose as a task file writes it: the joints that are not where the model has them."""
        away = np.abs(self._x - self._dynamics.initial_state) > 1e-9
        moved = [(name, self._entry(name)) for name in self._joints() if away[self._entry(name)]]
        entries = ", ".join(f'"{name}" = {self._x[entry]:.4g}' for name, entry in moved)
        return f"{{ {entries} }}" if entries else "{}"

    def _standing(self) -> Trajectory:
        """A trajectory that stays in this state."""
        return Trajectory(np.stack([self._x, self._x]), np.zeros((1, self._dynamics.nu)), dt=self._dynamics.dt)

    def _joints(self) -> list[str]:
        """Joints with one axis."""
        names, nq = self._dynamics.state_names, self._dynamics.model.nq
        return [name for name in names[:nq] if f"{name}.vel" in names[nq:]]

    def _entry(self, joint: str) -> int:
        return self._dynamics.state_names.index(joint)

    def _range(self, joint: str) -> tuple[float, float]:
        """Ends of the slider of a joint: its range, or round about where it is."""
        if joint in self._dynamics.joint_ranges:
            return self._dynamics.joint_ranges[joint]
        entry = self._entry(joint)
        j = int(np.flatnonzero(self._model.jnt_qposadr == entry)[0])
        room = TURN if self._model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE else SLIDE
        return float(self._x[entry] - room), float(self._x[entry] + room)

    def _geom(self, geom: int) -> str:
        if geom < 0:
            return "a flex"
        own = self._model.geom(geom).name
        return str(own or self._model.body(int(self._model.geom_bodyid[geom])).name or f"geom {geom}")


def view_model(
    dynamics: MujocoDynamics, host: str = "127.0.0.1", port: int = 8080, block: bool = True, dark: bool = False
) -> ModelView:
    """Show a model in a browser.

    Parameters
    ----------
    dynamics : MujocoDynamics
        The model.
    host, port
        Where to serve; a port that is taken gives way to the next free one.
    block : bool
        Stay until Ctrl-C. Otherwise return at once; the caller stops the view returned.
    dark : bool
        Whether the page is dark at first.
    """
    return present(ModelView(dynamics, host, port, dark=dark), block)
