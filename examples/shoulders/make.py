"""Makes a head with neck and shoulders, and a pose file that raises both shoulders.

    python3 make.py HEAD.obj FOLDER
    planish shell pose FOLDER/person.obj --poses FOLDER/poses.toml -o FOLDER/posed.glb

Input: the head of ICT FaceKit, whose licence stays in the header of the OBJ file. Output: poses.toml, and person.obj with
the parts `head`, `collar` (the rest of the input mesh) and `body`. The body is swept by ellipses from the neck, which
reaches into the head, to the chest. It is not joined to the head, because shells do not need a clean mesh. Needs numpy.
"""

import sys
from pathlib import Path

import numpy as np

# Height of the neck, relative to the height of the input mesh.
NECK = 0.3


def read_head(path):
    """Positions, texture coordinates, and faces as lists of (vertex, texture coordinate)."""
    header, points, uv, faces = [], [], [], []
    for line in open(path):
        words = line.split()
        if line.startswith("#"):
            header.append(line)
        elif words and words[0] == "v":
            points.append([float(x) for x in words[1:4]])
        elif words and words[0] == "vt":
            uv.append([float(x) for x in words[1:3]])
        elif words and words[0] == "f":
            corners = [word.split("/") for word in words[1:]]
            faces.append([(int(c[0]) - 1, int(c[1]) - 1 if len(c) > 1 and c[1] else None) for c in corners])
    return header, np.array(points), np.array(uv), faces


def smooth(x):
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def body(bottom, size, columns=96, rows=60):
    """Rings from the inside of the head down to the chest; y is up, x to the side, z to the front."""
    around = np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False)
    points = []
    for s in np.linspace(0.0, 1.0, rows):
        y = bottom + (0.27 - 1.0 * s) * size
        wide = 0.165 + 0.24 * smooth((s - 0.08) / 0.24) + 0.36 * smooth((s - 0.24) / 0.3)
        deep = 0.155 + 0.20 * smooth((s - 0.10) / 0.35)
        # A superellipse, because shoulders are squarer than a neck.
        power = 1.0 - 0.3 * smooth((s - 0.3) / 0.4)
        x = np.sign(np.cos(around)) * np.abs(np.cos(around)) ** power * wide
        z = np.sin(around) * deep
        y = np.full_like(x, y)
        points.append(np.stack([x * size, y, (z - 0.16) * size], axis=1))
    uv = [[c / columns, r / (rows - 1)] for r in range(rows) for c in range(columns)]
    faces = []
    for r in range(rows - 1):
        for c in range(columns):
            d = (c + 1) % columns
            a, b = r * columns + c, r * columns + d
            faces.append([a, b, b + columns, a + columns])
    return np.concatenate(points), np.array(uv), faces


def main(head_path, folder):
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    header, points, uv, faces = read_head(head_path)
    low, high = points.min(axis=0), points.max(axis=0)
    size = high[1] - low[1]
    middle = 0.5 * (low + high)
    body_points, body_uv, body_faces = body(low[1], size)
    body_points[:, 0] += middle[0]
    body_points[:, 2] += middle[2]
    with open(folder / "person.obj", "w") as out:
        out.writelines(header)
        for p in np.concatenate([points, body_points]):
            out.write("v %.6f %.6f %.6f\n" % tuple(p))
        for t in np.concatenate([uv, body_uv]) if len(uv) else body_uv:
            out.write("vt %.6f %.6f\n" % tuple(t))
        # The head ends at the neck. The parts of the input mesh below it deform with the body.
        is_head = [min(points[v][1] for v, _ in face) > low[1] + NECK * size for face in faces]
        for name, wanted in (("head", True), ("collar", False)):
            out.write(f"g {name}\n")
            for face in (face for face, own in zip(faces, is_head) if own == wanted):
                out.write("f " + " ".join(f"{v + 1}/{t + 1}" if t is not None else f"{v + 1}" for v, t in face) + "\n")
        out.write("g body\n")
        for face in body_faces:
            out.write("f " + " ".join(f"{v + 1 + len(points)}/{v + 1 + len(uv)}" for v in face) + "\n")
    shoulder_y = low[1] - 0.22 * size
    # Moves add up. Several with decreasing reach around each shoulder make a smooth hill.
    reaches = np.linspace(0.62, 0.12, 11) * size
    moves = ",\n  ".join(
        "{ near = [%.4f, %.4f, %.4f], within = %.4f, by = [0, %.4f, 0] }"
        % (middle[0] + side * 0.62 * size, shoulder_y, middle[2] - 0.16 * size, reach, 0.2 * size / len(reaches))
        for side in (-1, 1)
        for reach in reaches
    )
    (folder / "poses.toml").write_text(
        f"""controls = 120
blend = {0.2 * size:.4f}
[[rigid]]
part = "head"
motion = "held"
[[pose]]
name = "both shoulders raised"
move = [
  {moves}
]
[[keyframe]]
seconds = 0
weights = {{ "both shoulders raised" = 0 }}
[[keyframe]]
seconds = 1
weights = {{ "both shoulders raised" = 1 }}
[[keyframe]]
seconds = 2
weights = {{ "both shoulders raised" = 0 }}
"""
    )


if __name__ == "__main__":
    main(*sys.argv[1:3])
