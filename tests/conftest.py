"""Fixtures that several tests share."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_assets() -> Path:
    """The folder of third-party hands, objects and grasps beside the repository; skips where it is absent."""
    folder = Path(__file__).resolve().parents[1] / "../shared/assets"
    if not folder.is_dir():
        pytest.skip(f"the shared assets are not here: {folder}")
    return folder.resolve()
