"""Tables of validations: what a row says of a grasp is what the lines below say of all."""

from __future__ import annotations

import io
import re

import numpy as np
from rich.console import Console

from grasp_refine.measures.measures import VALIDATED
from grasp_refine.measures.metrics import Metrics
from grasp_refine.results.validation_table import validation_table
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.validation.engine_table import MUJOCO
from grasp_refine.validation.trials import Reason
from grasp_refine.validation.validate import Validated
from made_results import made_trials


def validated(reason: np.ndarray, peak_m: np.ndarray, peak_rad: np.ndarray) -> Validated:
    """Grasps whose object ends half as far away as it once was."""
    count = len(reason)
    trials = made_trials(
        reason, displacement_m=peak_m / 2, angle_rad=peak_rad / 2, peak_m=peak_m, peak_rad=peak_rad,
        time_s=np.where(reason == Reason.HELD, np.nan, 0.5),
    )  # fmt: skip
    nothing = np.zeros(count)
    number = np.arange(count)
    metrics = Metrics({measure.name: np.full(count, 0.95) for measure in VALIDATED})
    return Validated(
        np.full(count, "box"),
        np.ones(count),
        number,
        number,
        nothing,
        nothing,
        metrics,
        {MUJOCO: trials},
        np.full(count, 0.1),
    )


def text(found: Validated) -> str:
    stream = io.StringIO()
    Console(file=stream, width=200, emoji=False).print(validation_table(found, "claw", DEXGRASPBENCH, ()))
    return stream.getvalue()


def test_rows_and_the_line_on_held_objects_have_the_same_movements() -> None:
    reason = np.full((4, 2), Reason.HELD)
    reason[3, 1] = Reason.MOVED
    peak_m = np.array([[0.0015, 0.0061], [0.0055, 0.0031], [0.0012, 0.0057], [0.002, 0.08]])
    peak_rad = np.radians([[1.0, 2.0], [4.0, 3.0], [0.5, 0.25], [1.0, 30.0]])
    found = text(validated(reason, peak_m, peak_rad))
    rows = re.findall(r"^ +\d .* (\d+\.\d) +(\d+\.\d)  (held|moved)", found, re.MULTILINE)
    assert rows == [("6.1", "2.0", "held"), ("5.5", "4.0", "held"), ("5.7", "0.5", "held"), ("40.0", "15.0", "moved")]
    (line,) = re.findall(r"objects that were held moved (.*) mm and rotated (.*) deg", found)
    median, _, worst = line[0].split(" / ")
    assert (median, worst) == ("5.7", "6.1")
    median, _, worst = line[1].split(" / ")
    assert (median, worst) == ("2.0", "4.0")
