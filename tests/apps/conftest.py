"""Pages in less time."""

import pytest

from grasp_refine_apps.batch import page
from grasp_refine_apps.report import drawing


@pytest.fixture
def without_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports of batches have no charts, which take a second to draw."""
    monkeypatch.setattr(page, "chart", lambda *_: "")


@pytest.fixture
def one_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are taken from one side, without the search for the best of 36."""
    monkeypatch.setattr(drawing, "SIDES", drawing.SIDES[:1])
