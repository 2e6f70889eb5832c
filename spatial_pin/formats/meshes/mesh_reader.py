"""Reads meshes in a process of its own: `python mesh_reader.py FOLDER FILE FILE ...`.

The reader of meshes (assimp, inside coal) can end the process that it runs in. What it reads is
written to FOLDER as K.npz, points (N, 3), corners of triangles (M, 3) and their colours (M, 4), or
why not as K.txt. Formats with colours are read here, for that reader keeps none; what is not
understood here is left to it. It imports nothing else of the library, so that it starts fast.
"""

import importlib
import os
import sys

MEMORY = 4 << 30  # bytes of address space: the libraries alone take a quarter of it
GROWTH = 200  # bytes for a byte of the file, four times what the reader was seen to take
COLOURED = {".dae": "collada_mesh", ".obj": "wavefront_mesh"}  # endings, and who reads them here


def main(folder: str, files: list[str]) -> None:
    """Read all files, the K-th of which no earlier run has begun."""
    limit_memory(files)
    import numpy as np

    sys.path.append(os.path.dirname(__file__))
    for k, file in enumerate(files):
        begun = os.path.join(folder, f"{k}.begun")
        if os.path.exists(begun):
            continue
        with open(begun, "w", encoding="utf-8"):
            pass
        target = os.path.join(folder, str(k))
        try:
            points, corners, colours = coloured(file) or plain(file, folder)
            np.savez(f"{target}.npz", points=points, corners=corners, colours=colours)
        except Exception as error:  # whatever the reader says
            with open(f"{target}.txt", "w", encoding="utf-8", errors="replace") as report:
                report.write(str(error))


def coloured(file):
    """Return points, corners and colours of a mesh; None where it is not understood here."""
    name = COLOURED.get(os.path.splitext(file)[1].lower())
    try:
        return importlib.import_module(name).read(file) if name else None
    except Exception:  # the other reader says what is wrong with it
        return None


def plain(file, folder):
    """Return points and corners of a mesh, and no colours.

    Of a mesh with materials a copy is read that names none: the reader would open their files.
    """
    import coal
    import numpy as np

    if file.lower().endswith(".obj"):
        copy = os.path.join(folder, "mesh.obj")
        with open(file, "rb") as stream, open(copy, "wb") as target:
            lines = stream.read().replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
            target.write(b"\n".join(x for x in lines if not x.lstrip().startswith(b"mtllib")))
        file = copy
    mesh = coal.MeshLoader().load(file, np.ones(3))
    triangles = map(mesh.tri_indices, range(mesh.num_tris))
    corners = np.array([(t[0], t[1], t[2]) for t in triangles], dtype=np.int64).reshape(-1, 3)
    if not len(corners):
        raise ValueError("it has no triangles")
    return np.array(mesh.vertices(), dtype=float), corners, np.full((len(corners), 4), np.nan)


def limit_memory(files: list[str]) -> None:
    """Let a number in a file not ask for more memory than meshes of that size can need."""
    try:
        import resource
    except ImportError:  # not on this system
        return
    most = MEMORY + GROWTH * max(os.path.getsize(file) for file in files)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
