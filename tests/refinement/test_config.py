"""All settings in one value: what could not be done is refused at once."""

import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.adam import Adam
from refusals import refused


@pytest.mark.parametrize("width", [0, -3])
def test_a_batch_of_nobody_is_refused(width: int) -> None:
    with refused(GraspRefineError, "width", "1", width):
        Config(width=width)


@pytest.mark.parametrize(("dtype", "device"), [("float32", "cpu"), ("float64", "cuda"), ("float32", "cuda")])
def test_levenberg_marquardt_has_one_number_type_and_device(dtype: str, device: str) -> None:
    named = ("levenberg-marquardt", "float64", "cpu", dtype, device, "descent", "adam")
    with refused(GraspRefineError, *named):
        Config(dtype=dtype, device=device)
    assert Config(solver=Adam(), dtype=dtype, device=device).dtype == dtype
