"""All settings in one value: what could not be done is refused at once."""

import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.terms.weights import Weights, term_kinds
from refusals import refused


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("width", 0), ("starts", 0), ("margin", -1e-3), ("clearance", -1e-3), ("pressure", float("nan")),
        ("tolerance", float("inf")), ("seed", -1), ("seconds", 0.0),
    ],
)  # fmt: skip
def test_numbers_out_of_their_range_are_refused(name: str, value: float) -> None:
    with refused(GraspRefineError, name, f"{value:g}"):
        Config(**{name: value})


@pytest.mark.parametrize("name", term_kinds())
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_weights_that_are_negative_or_not_finite_are_refused(name: str, value: float) -> None:
    with refused(GraspRefineError, name, f"{value:g}"):
        Weights(**{name: value})


def test_grasps_hold_by_least_squares_with_forces_alone() -> None:
    assert Config().holds and not Config(weights=Weights(wrench=0.0)).holds and not Config(solver=Adam()).holds


@pytest.mark.parametrize(("dtype", "device"), [("float32", "cpu"), ("float64", "cuda"), ("float32", "cuda")])
def test_levenberg_marquardt_has_one_number_type_and_device(dtype: str, device: str) -> None:
    named = ("levenberg-marquardt", "float64", "cpu", dtype, device, "descent", "adam")
    with refused(GraspRefineError, *named):
        Config(dtype=dtype, device=device)
    assert Config(solver=Adam(), dtype=dtype, device=device).dtype == dtype
