"""The script that cuts the embedded objects writes the files that come with the program, and no others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.geometry import pieces
from grasp_refine.geometry.cache import load
from grasp_refine_apps.authoring.cut_embedded import main


def test_it_writes_what_comes_with_the_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def decompose(vertices: np.ndarray, *_: object, **__: object) -> list[np.ndarray]:
        return [vertices]

    monkeypatch.setattr(pieces, "decompose", decompose)
    (tmp_path / "old.npz").touch()
    main(["--out", str(tmp_path)])
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made == sorted(path.name for path in pieces.SHIPPED.iterdir())
    for name in made:
        ((vertices, _),) = load(tmp_path / name)
        np.testing.assert_allclose(np.linalg.norm(np.ptp(vertices, axis=0)), 1.0)
        assert (tmp_path / name).stat().st_mode & 0o444 == 0o444
