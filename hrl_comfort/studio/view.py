"""Views: the cell's MuJoCo geoms as viser meshes, and the poses of its bodies in a picture."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable
from functools import partial
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser
from numpy.typing import NDArray

from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.humans.body import HIP_M
from hrl_comfort.plots.clip import Frame, set_pose
from hrl_comfort.scene.human import LIMBS
from hrl_comfort.scene.looks import COLLISION_GROUP, dressed
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]

Colour = tuple[float, ...]
"""(r, g, b, opacity), 0 to 1."""
CONTACT_RGB, ZONE_RGB, GRID_RGB = (220, 40, 40), (224, 160, 32), (176, 184, 192)
HANDLE_M = 0.18
"""Length of the axes of a hand's handle."""
TRAIL_RGB, TRAIL_STEPS = (230, 120, 30), 150
"""Colour of the trail of the tool, and its length, control steps."""
LABEL_M = 1.15
"""Height of a cell's name over the robot's base."""
FLOOR_M = 30.0
"""Radius of the floor."""
ZONE_M = 0.25
"""From the person's axis to the side of the body."""
_SHAPE = mujoco.mjtGeom


def shape_mesh(kind: int, size: Array) -> trimesh.Trimesh:
    """Return the mesh of a MuJoCo geom or site in its own frame, m; `size` (3,) as MuJoCo has it.

    Raises:
      ValueError: a kind that the cell does not have.
    """
    if kind == _SHAPE.mjGEOM_SPHERE:
        return trimesh.creation.icosphere(subdivisions=3, radius=size[0])
    if kind == _SHAPE.mjGEOM_CAPSULE:
        mesh = trimesh.creation.capsule(height=2 * size[1], radius=size[0], count=[16, 16])
        mesh.apply_translation((0, 0, -mesh.bounds.mean(axis=0)[2]))  # trimesh's begins at its lower end
        return mesh
    if kind == _SHAPE.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(radius=size[0], height=2 * size[1], sections=24)
    if kind == _SHAPE.mjGEOM_BOX:
        return trimesh.creation.box(extents=2 * size)
    if kind == _SHAPE.mjGEOM_PLANE:
        return trimesh.creation.cylinder(radius=FLOOR_M, height=0.002, sections=64)
    raise ValueError(f"a geom of MuJoCo's kind {kind} cannot be shown")


def _mesh(model: Any, index: int) -> trimesh.Trimesh:
    """Return a mesh of the model; vertices that share a place stay apart where an edge is sharp."""
    first, count = model.mesh_vertadr[index], model.mesh_vertnum[index]
    begin, faces = model.mesh_faceadr[index], model.mesh_facenum[index]
    return trimesh.Trimesh(
        model.mesh_vert[first : first + count], model.mesh_face[begin : begin + faces], process=False
    )


def body_meshes(model: Any, collision: bool = False) -> dict[int, list[tuple[Colour, trimesh.Trimesh]]]:
    """Return, by body, a mesh for each colour of its visible geoms and sites, in the body's frame.

    Of a dressed model it is the looks, or with `collision` what they hide.
    """
    parts: dict[tuple[int, Colour], list[trimesh.Trimesh]] = defaultdict(list)
    for prefix, bodies in (("geom", model.geom_bodyid), ("site", model.site_bodyid)):
        kinds, sizes, colours, places, turns, groups = (
            getattr(model, f"{prefix}_{name}") for name in ("type", "size", "rgba", "pos", "quat", "group")
        )
        for index, body in enumerate(bodies):
            hidden = model.names[getattr(model, f"name_{prefix}adr")[index] :].startswith(b"robot/tcp")
            if hidden or (prefix == "geom" and groups[index] == COLLISION_GROUP) != collision:
                continue
            kind = int(kinds[index])
            meshed = prefix == "geom" and kind == _SHAPE.mjGEOM_MESH
            mesh = _mesh(model, int(model.geom_dataid[index])) if meshed else shape_mesh(kind, sizes[index])
            matrix = trimesh.transformations.quaternion_matrix(turns[index])
            matrix[:3, 3] = places[index]
            mesh.apply_transform(matrix)
            parts[int(body), tuple(float(value) for value in colours[index])].append(mesh)
    found: dict[int, list[tuple[Colour, trimesh.Trimesh]]] = defaultdict(list)
    for (body, colour), meshes in parts.items():
        if colour[3] > 0:
            found[body].append((colour, trimesh.util.concatenate(meshes)))
    return found


class CellView:
    """A cell on a page.

    Args:
      server: of the page.
      scene: compiled cell.
      name: of the cell, under which its nodes lie.
      offset_m: place of the robot's base on the page.
    """

    def __init__(
        self, server: viser.ViserServer, scene: Scene, name: str, offset_m: tuple[float, float, float]
    ) -> None:
        scene = dressed(scene)
        self._server, self._scene, self._data = server, scene, mujoco.MjData(scene.model)
        self.offset_m = offset_m
        self._root = server.scene.add_frame(f"/{name}", show_axes=False, position=offset_m)
        self._handles: list[viser.TransformControlsHandle] = []
        self.person: list[viser.MeshHandle] = []
        """Meshes of the first person, whom a hand may move."""
        people: list[viser.MeshHandle] = []
        self._shapes: dict[bool, list[viser.MeshHandle]] = {False: [], True: []}
        """The looks, and what collides in their place."""
        limbs = [scene.model.body(limb).id for limb in scene.limbs]
        self._frames = {
            body: server.scene.add_frame(f"/{name}/body_{body}", show_axes=False) for body in range(scene.model.nbody)
        }
        collide = body_meshes(scene.model, collision=True)
        for collision, shown in ((False, body_meshes(scene.model)), (True, collide)):
            for body, meshes in shown.items():
                for index, (colour, mesh) in enumerate(meshes):
                    handle = server.scene.add_mesh_simple(
                        f"/{name}/body_{body}/{collision:d}_{index}",
                        np.asarray(mesh.vertices, dtype=np.float32),
                        np.asarray(mesh.faces, dtype=np.uint32),
                        color=tuple(round(255 * value) for value in colour[:3]),
                        opacity=None if colour[3] >= 1 else colour[3],
                        flat_shading=False,
                        cast_shadow=body > 0,
                        receive_shadow=True,
                        visible=not collision,
                    )
                    if collision or body in collide:
                        self._shapes[collision].append(handle)
                    if body in limbs:
                        people.append(handle)
                    if body in limbs[: len(LIMBS)]:
                        self.person.append(handle)
        server.scene.add_grid(
            f"/{name}/grid", infinite_grid=True, fade_distance=12.0, cell_size=0.5, cell_color=GRID_RGB,
            section_color=GRID_RGB, shadow_opacity=0.0, position=(0.0, 0.0, scene.floor_z + 2e-3),
        )  # fmt: skip
        disc = trimesh.creation.cylinder(radius=1.0, height=1e-3, sections=48)
        self._zone = server.scene.add_mesh_simple(
            f"/{name}/zone",
            np.asarray(disc.vertices, dtype=np.float32),
            np.asarray(disc.faces, dtype=np.uint32),
            color=ZONE_RGB,
            opacity=0.4,
            visible=False,
        )
        self._trail: deque[Array] = deque(maxlen=TRAIL_STEPS)
        self._line = server.scene.add_line_segments(
            f"/{name}/trail", np.zeros((0, 2, 3), dtype=np.float32), colors=TRAIL_RGB, line_width=2.5
        )
        self._label: viser.LabelHandle | None = None
        self._people = [(handle, handle.color) for handle in people]
        self._shown: dict[int, Array] = {}

    def show(self, frame: Frame) -> None:
        """Put every body where it is in a picture; messages are sent for bodies that moved alone."""
        set_pose(self._data, self._scene, frame)
        for body, handle in self._frames.items():
            pose = np.concatenate([self._data.xpos[body], self._data.xquat[body]])
            old = self._shown.get(body)
            if old is None or np.abs(pose[:3] - old[:3]).max() > 1e-5:
                handle.position = pose[:3]
                visible = bool(pose[0] < FAR_AWAY_M / 2)
                if handle.visible != visible:
                    handle.visible = visible
            if old is None or np.abs(pose[3:] - old[3:]).max() > 1e-5:
                handle.wxyz = pose[3:]
            self._shown[body] = pose

    def show_hands(self, hands: Array | None, moved: Callable[[Array], None]) -> None:
        """Show a handle at each of `hands` (2, 3) m, in the person's frame; None takes them off.

        `moved` gets the hands where they are dragged to.
        """
        if hands is None:
            while self._handles:
                self._handles.pop().remove()
            return
        if self._handles:
            return
        trunk = self._frames[self._scene.model.body(LIMBS[0]).id].name
        hip = np.array([0.0, 0.0, HIP_M])
        held = hands.copy()

        async def follow(side: int, event: viser.TransformControlsEvent) -> None:  # so that its phases stay in order
            held[side] = np.asarray(event.target.position) + hip
            moved(held.copy())

        for side, name in enumerate(("left_hand", "right_hand")):
            handle = self._server.scene.add_transform_controls(
                f"{trunk}/{name}",
                scale=HANDLE_M,
                disable_rotations=True,
                disable_sliders=True,
                depth_test=False,
                position=hands[side] - hip,
            )
            handle.on_update(partial(follow, side))
            self._handles.append(handle)

    def show_zone(self, place: Array, reach_m: float) -> None:
        """Show the floor that a person at `place` (2,) m may reach before the arm is slow; hide it where that is 0."""
        self._zone.visible = reach_m > 0 and bool(place[0] < FAR_AWAY_M / 2)
        if self._zone.visible:
            self._zone.position = (*place, self._scene.floor_z + 4e-3)
            self._zone.scale = ZONE_M + reach_m

    def name(self, text: str) -> None:
        """Show a name over the cell."""
        if self._label is None:
            self._label = self._server.scene.add_label(
                f"{self._root.name}/label", text, position=(0.0, 0.0, LABEL_M), anchor="bottom-center"
            )
        elif self._label.text != text:
            self._label.text = text

    def follow_tool(self, places: Array) -> None:
        """Draw the trail of the tool on to `places` (K, 3) m."""
        self._trail.extend(places)
        if len(points := np.array(self._trail, dtype=np.float32)) > 1:
            self._line.points = np.stack([points[:-1], points[1:]], axis=1)

    def begin_trail(self) -> None:
        """Begin the trail of the tool anew."""
        self._trail.clear()
        self._line.points = np.zeros((0, 2, 3), dtype=np.float32)

    def remove(self) -> None:
        """Take the cell off the page."""
        self._root.remove()

    def set_visible(self, visible: bool) -> None:
        """Show or hide the whole cell."""
        self._root.visible = visible

    def show_collision_shapes(self, shown: bool) -> None:
        """Show the shapes that collide in place of the looks."""
        for collision, handles in self._shapes.items():
            for handle in handles:
                handle.visible = collision == shown

    def flash(self, contact: bool) -> None:
        """Paint people red while a contact is shown."""
        for handle, colour in self._people:
            wanted = CONTACT_RGB if contact else colour
            if handle.color != wanted:
                handle.color = wanted
