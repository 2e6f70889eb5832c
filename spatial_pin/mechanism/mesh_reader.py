"""Reads meshes in a process of its own: `python mesh_reader.py FOLDER FILE FILE ...`.

The reader of meshes (assimp, inside coal) can end the process that it runs in. What it reads is
written to FOLDER as K.npz, points (N, 3) and corners of triangles (M, 3), or why not as K.txt.
It imports nothing of the library, so that it starts fast.
"""

import os
import sys

MEMORY = 4 << 30  # bytes of address space: the libraries alone take a quarter of it
GROWTH = 200  # bytes for a byte of the file, four times what the reader was seen to take

def main(folder: str, files: list[str]) -> None:
    """Read all files, the K-th of which no earlier run has begun."""
    limit_memory(files)
    import coal
    import numpy as np

    for k, file in enumerate(files):
        begun = os.path.join(folder, f"{k}.begun")
        if os.path.exists(begun):
            continue
        with open(begun, "w", encoding="utf-8"):
            pass
        target = os.path.join(folder, str(k))
        try:
            mesh = coal.MeshLoader().load(file, np.ones(3))
            triangles = map(mesh.tri_indices, range(mesh.num_tris))
            corners = [(t[0], t[1], t[2]) for t in triangles]
            if not corners:
                raise ValueError("it has no triangles")
            points = np.array(mesh.vertices(), dtype=float)
            np.savez(f"{target}.npz", points=points, corners=np.array(corners, dtype=np.int64))
        except Exception as error:  # whatever the reader says
            with open(f"{target}.txt", "w", encoding="utf-8", errors="replace") as report:
                report.write(str(error))


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
