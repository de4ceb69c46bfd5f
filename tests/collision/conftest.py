"""Every test that asks, asks each engine."""

import pytest

from grasp_refine.collision.engine import VARIABLE, why_not_native


@pytest.fixture(params=["native", "python"])
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """What "auto" means; skips where the compiled engine is not there."""
    if request.param == "native" and why_not_native():
        pytest.skip(f"no compiled engine: {why_not_native()}")
    monkeypatch.setenv(VARIABLE, request.param)
    return request.param
