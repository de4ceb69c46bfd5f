"""Where the files that come with the program are found."""

from pathlib import Path

import pytest

from grasp_refine.assets import embedded
from grasp_refine.core.errors import AssetError
from refusals import refused


def test_the_folder_in_the_package_wins_over_the_one_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "package").mkdir()
    monkeypatch.setattr(embedded, "__file__", str(tmp_path / "package/assets/embedded.py"))
    with refused(AssetError, "'robots'", tmp_path / "package/robots", f" {tmp_path / 'robots'}"):
        embedded.resource_dir("robots")
    (tmp_path / "robots").mkdir()
    assert embedded.resource_dir("robots") == tmp_path / "robots"
    (tmp_path / "package/robots").mkdir()
    assert embedded.resource_dir("robots") == tmp_path / "package/robots"
