"""Facts about hands: what lies beside them counts as example grasps only where it holds some."""

import shutil
from pathlib import Path

import numpy as np

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.hands.hand import load_hand
from grasp_refine_apps.report.hand_facts import examples


def test_only_files_with_grasps_are_examples(tmp_path: Path):
    shutil.copytree(resource_dir("robots") / "franka_hand", tmp_path / "hand")
    hand = load_hand(str(tmp_path / "hand"), candidates=16)
    names = [path.name for path in examples(hand)]
    assert "example_mug.npz" in names
    (tmp_path / "hand/garbage.npz").write_bytes(b"PK\x03\x04 garbage")
    np.savez(tmp_path / "hand/weights.npz", weights=np.zeros(3))
    (tmp_path / "hand/pointer.npz").write_text("version https://git-lfs.github.com/spec/v1\n")
    assert [path.name for path in examples(hand)] == names
