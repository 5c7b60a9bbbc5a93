"""Make the meshes of the UR arms, ARM.npz of this folder, from the package airo-models.

`pip install airo-models==0.0.12 fast-simplification==0.2.0`, then `python -m hrl_comfort.scene.looks.make_arms`.
The licence of what is made is ARMS_LICENSE.txt.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import trimesh

from hrl_comfort.scene.looks.arms import ARMS, COLOURS, FOLDER, UNIT_M
from hrl_comfort.scene.ur import LINKS, UR_ARMS, UrModel

FACES = {"upper_arm_link": 6000, "wrist_3_link": 600}
"""Most faces of a link, FACES_ELSE of the others."""
FACES_ELSE = 3500
CREASE_RAD = 0.6
"""Edges with a larger angle between their faces stay sharp."""
OMITTED = ("M_Text", "cable")
"""Materials of label and cable."""
MATERIALS = {"URBlue": "cap", "LinkGrey": "link", "JointGrey": "joint", "Black": "black", "Belt": "black"}
"""Kinds of COLOURS by the beginning of a material's name; `joint` of those that are not here."""


def link_frames(arm: UrModel) -> dict[str, Any]:
    """Return, by link of the URDF, its body here and its pose (4, 4) in the body's frame, which is a DH frame."""
    turned = trimesh.transformations.rotation_matrix
    moved = trimesh.transformations.translation_matrix
    x = (1, 0, 0)
    poses = [
        np.eye(4),
        turned(-np.pi / 2, x),
        moved((-arm.a_m[1], 0, 0)),
        moved((-arm.a_m[2], 0, 0)),
        turned(-np.pi / 2, x),
        turned(np.pi / 2, x),
        np.eye(4),
    ]
    names = [name if name.endswith("_link") else f"{name}_link" for name in LINKS]
    return dict(zip(["base_link_inertia", *names], zip(["base", *LINKS], poses, strict=True), strict=True))


def parts(folder: Path, arm: UrModel) -> dict[str, np.ndarray]:
    """Return the arrays of the file of an arm, from the folder of its URDF."""
    made: dict[str, np.ndarray] = {}
    text = (folder / f"{arm.name}.urdf").read_text(encoding="utf-8")
    root = ElementTree.fromstring(text.replace("drake:", ""))  # a prefix without a namespace
    for name, (body, frame) in link_frames(arm).items():
        visual = root.find(f"link[@name='{name}']/visual")
        assert visual is not None
        origin, mesh = visual.find("origin"), visual.find("geometry/mesh")
        assert origin is not None and mesh is not None
        place, turn = (np.array(origin.attrib[key].split(), dtype=float) for key in ("xyz", "rpy"))
        pose = frame @ trimesh.transformations.euler_matrix(*turn) + 0.0
        pose[:3, 3] += frame[:3, :3] @ place
        loaded: Any = trimesh.load(folder / mesh.attrib["filename"], process=False)
        geometry = loaded.geometry if isinstance(loaded, trimesh.Scene) else {mesh.attrib["filename"]: loaded}
        kinds: dict[str, list[trimesh.Trimesh]] = {}
        for part in geometry.values():
            material = str(part.visual.material.name)
            if not material.startswith(OMITTED):
                kind = next((kind for start, kind in MATERIALS.items() if material.startswith(start)), "joint")
                kinds.setdefault(kind, []).append(part)
        joined_parts = {kind: trimesh.util.concatenate(each) for kind, each in kinds.items()}
        total = sum(len(part.faces) ** 0.5 for part in joined_parts.values())
        for kind, part in joined_parts.items():
            joined = trimesh.Trimesh(part.vertices, part.faces)
            joined.merge_vertices()
            wanted = round(FACES.get(name, FACES_ELSE) * len(part.faces) ** 0.5 / total)
            if wanted < len(joined.faces):
                joined = joined.simplify_quadric_decimation(face_count=wanted, aggression=2)
            joined = trimesh.graph.smooth_shade(joined, angle=CREASE_RAD)
            joined.apply_transform(pose)
            made[f"{body}.{kind}.vertices"] = np.round(joined.vertices / UNIT_M).astype(np.int16)
            made[f"{body}.{kind}.faces"] = joined.faces.astype(np.uint16)
            assert kind in COLOURS
    return made


def main() -> None:
    """Write the files."""
    for name in ARMS:
        arrays: dict[str, Any] = parts(Path(str(files("airo_models") / "arms" / name)), UR_ARMS[name])
        np.savez_compressed(FOLDER / f"{name}.npz", **arrays)


if __name__ == "__main__":
    main()
