"""Files that users upload and download: grasps, meshes, hands, results, films."""
