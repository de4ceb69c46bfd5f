"""Recognition of Git LFS pointers."""

from __future__ import annotations

from pathlib import Path

import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.lfs_pointer import refuse_lfs_pointer

POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:" + 64 * "0" + "\nsize 7293684\n"


def test_a_pointer_is_refused_by_the_name_of_its_file_and_the_command_that_fetches_it(tmp_path: Path) -> None:
    path = tmp_path / "g.npz"
    path.write_text(POINTER)
    with pytest.raises(GraspFileError, match=r"g\.npz.*git lfs pull"):
        refuse_lfs_pointer(path, "grasp file", GraspFileError)


def test_other_files_and_missing_ones_pass(tmp_path: Path) -> None:
    for name, text in (("empty", ""), ("short", POINTER[:20]), ("quoted", "# " + POINTER)):
        path = tmp_path / name
        path.write_text(text)
        refuse_lfs_pointer(path, "mesh", GraspFileError)
    refuse_lfs_pointer(tmp_path / "missing", "mesh", GraspFileError)
    refuse_lfs_pointer(tmp_path, "mesh", GraspFileError)
