"""All readers that are fuzzed, by name."""

from __future__ import annotations

from fuzz import (
    cache_files,
    foreign_grasps,
    hand_tomls,
    job_lists,
    manifests,
    meshes,
    mjcfs,
    npz_files,
    object_names,
    packed_grasps,
    scans,
    uploads,
    urdfs,
    validation_files,
)

READERS = {
    reader.name: reader
    for reader in (
        urdfs.READER,
        mjcfs.READER,
        meshes.READER,
        scans.READER,
        npz_files.READER,
        foreign_grasps.READER,
        packed_grasps.ARCHIVES,
        packed_grasps.TABLES,
        hand_tomls.READER,
        object_names.LIST_READER,
        object_names.READER,
        job_lists.READER,
        manifests.READER,
        cache_files.READER,
        validation_files.READER,
        uploads.READER,
    )
}
