#!/usr/bin/env python3
"""Runs one operation of another mesh program in its own process, so that its peak memory can be measured.

    python mesh_worker.py open3d DEPTH CLOUD.npz MESH.ply       Open3D's Poisson reconstruction
    python mesh_worker.py pymeshlab DEPTH CLOUD.npz MESH.ply    screened Poisson reconstruction of PyMeshLab
    python mesh_worker.py intersections MESH.ply                triangles that intersect others, by PyMeshLab

The cloud has arrays `points` and `normals`. Before both reconstructions, Open3D removes outliers: points with
fewer than 5 others within 8 times the median distance to the nearest point. Its statistical filter (20
neighbours, 2 standard deviations) removes good readings where only one scan sees the surface: the rms of
Poisson's distances to the readings of the bunny becomes 1.17 mm instead of 0.13 mm.

Prints one JSON object; `seconds` includes the removal but no files.
"""

import json
import sys
import time

import numpy as np


def cleaned(path):
    """The points and normals of a cloud that Open3D does not consider outliers."""
    import open3d as o3d

    cloud, stored = o3d.geometry.PointCloud(), np.load(path)
    cloud.points = o3d.utility.Vector3dVector(stored["points"])
    cloud.normals = o3d.utility.Vector3dVector(stored["normals"])
    start = time.perf_counter()
    spacing = np.median(cloud.compute_nearest_neighbor_distance())
    return cloud.remove_radius_outlier(5, 8 * spacing)[0], start


def open3d(depth, path, out):
    import open3d as o3d

    cloud, start = cleaned(path)
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=int(depth))
    seconds = time.perf_counter() - start
    o3d.io.write_triangle_mesh(out, mesh, write_vertex_normals=False)
    return {"seconds": seconds}


def pymeshlab(depth, path, out):
    import pymeshlab as ml

    cloud, start = cleaned(path)
    meshes = ml.MeshSet()
    points, normals = np.asarray(cloud.points), np.asarray(cloud.normals)
    meshes.add_mesh(ml.Mesh(vertex_matrix=points, v_normals_matrix=normals))
    meshes.generate_surface_reconstruction_screened_poisson(depth=int(depth))
    seconds = time.perf_counter() - start
    meshes.save_current_mesh(out, save_vertex_normal=False)
    return {"seconds": seconds}


def intersections(path):
    import pymeshlab as ml

    meshes = ml.MeshSet()
    meshes.load_new_mesh(path)
    meshes.compute_selection_by_self_intersections_per_face()
    return {"triangles": int(meshes.current_mesh().face_selection_array().sum())}


if __name__ == "__main__":
    operation = {"open3d": open3d, "pymeshlab": pymeshlab, "intersections": intersections}[sys.argv[1]]
    print(json.dumps(operation(*sys.argv[2:])))
