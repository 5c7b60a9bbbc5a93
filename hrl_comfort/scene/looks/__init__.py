"""Looks: what pictures show of a cell in place of the shapes that collide.

`dressed` returns a copy of a compiled cell for pictures. What is simulated has no looks: it is neither slower nor does
anything that reads its shapes see them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import mujoco

from hrl_comfort.scene.human import LIMBS
from hrl_comfort.scene.looks.arms import arm_parts
from hrl_comfort.scene.looks.cell import gripper_parts, pedestal_parts, place_parts
from hrl_comfort.scene.looks.person import person_parts
from hrl_comfort.scene.looks.shapes import Part, block
from hrl_comfort.scene.workcell import Scene

EDGE_M = 0.0005
"""Radius of the edges of a box."""
COLLISION_GROUP = 3
"""Group of the shapes that collide in a dressed cell; MuJoCo does not draw it unless it is asked to."""

__all__ = ["COLLISION_GROUP", "Part", "dressed", "parts"]


def parts(scene: Scene) -> Iterator[Part]:
    """Yield the looks of a cell, on bodies of its model; a body without any looks as it collides."""
    model = scene.model
    for name, place in scene.cell.places.items():
        yield from place_parts(f"place_{name}", place, scene.floor_z - place.top_m[2])
    for name, obstacle in scene.cell.obstacles.items():
        if obstacle.shape == "box":
            red, green, blue = obstacle.rgb
            yield block(f"obstacle_{name}", (red, green, blue, 1.0), obstacle.size_m, (0.0, 0.0, 0.0), EDGE_M)
    yield from pedestal_parts(min(scene.floor_z, -0.05))
    yield from arm_parts(scene.robot)
    if scene.gripper is None and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "robot/gripper") >= 0:
        yield from gripper_parts()
    for index in range(len(scene.limbs) // len(LIMBS)):
        yield from person_parts(index)


def dressed(scene: Scene) -> Scene:
    """Return a copy of a cell whose model has its looks, and the shapes that they hide in COLLISION_GROUP."""
    spec = mujoco.MjSpec.from_string(scene.xml, dict(scene.assets))
    worn = list(parts(scene))
    bodies = {part.body for part in worn}
    for body in spec.bodies:
        for geom in body.geoms:
            geom.group = COLLISION_GROUP if body.name in bodies else geom.group
    spec.add_material(name="cloth", specular=0.1, shininess=0.2)
    for index, part in enumerate(worn):
        mesh = spec.add_mesh(name=f"look_{index}")
        mesh.uservert, mesh.userface = part.vertices.ravel().tolist(), part.faces.ravel().tolist()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        geom = spec.body(part.body).add_geom(
            name=f"look_{index}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, rgba=part.colour
        )
        geom.contype = geom.conaffinity = 0
        geom.mass = 0.0
        if part.body in scene.limbs:
            geom.material = "cloth"
    _light(spec)
    return replace(scene, model=spec.compile())


def _light(spec: mujoco.MjSpec) -> None:
    """Give a cell a tiled floor without an end, soft light from a second side, and finer shadows."""
    tiles = spec.add_texture(
        name="tiles", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        width=256, height=256, rgb1=(1.0, 1.0, 1.0), mark=mujoco.mjtMark.mjMARK_EDGE, markrgb=(0.86, 0.86, 0.86),
    )  # fmt: skip
    material = spec.add_material(name="tiles", texrepeat=(1.0, 1.0), texuniform=True, specular=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = tiles.name
    floor = spec.geom("floor")
    floor.size, floor.material, floor.rgba = (0.0, 0.0, 0.5), "tiles", (0.71, 0.72, 0.735, 1.0)
    fill = spec.worldbody.add_light(name="fill", pos=(-2.0, 1.5, 2.5), dir=(0.6, -0.45, -0.65), castshadow=False)
    fill.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    fill.diffuse, fill.specular = (0.12, 0.13, 0.15), (0.1, 0.1, 0.1)
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = (0.38,) * 3, (0.32,) * 3
    spec.visual.quality.shadowsize, spec.visual.map.shadowclip = 2048, 1.5
    spec.visual.rgba.haze = (0.90, 0.93, 0.96, 1.0)
