"""Where the files that come with the program are found."""

from pathlib import Path

import pytest
from refusals import refused

from grasp_refine import assets
from grasp_refine.errors import AssetError


def test_the_folder_in_the_package_wins_over_the_one_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "package").mkdir()
    monkeypatch.setattr(assets, "__file__", str(tmp_path / "package/assets.py"))
    with refused(AssetError, "'robots'", tmp_path / "package/robots", f" {tmp_path / 'robots'}"):
        assets.resource_dir("robots")
    (tmp_path / "robots").mkdir()
    assert assets.resource_dir("robots") == tmp_path / "robots"
    (tmp_path / "package/robots").mkdir()
    assert assets.resource_dir("robots") == tmp_path / "package/robots"
