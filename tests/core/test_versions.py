"""Versions that are required, and those that are installed."""

from __future__ import annotations

import numpy as np
import pytest

from grasp_refine.core.versions import Requirement, requirements, versions


def test_requirements_are_as_in_the_project():
    needs = {need.name: need for need in requirements()}
    assert needs["torch"].range == ">=2.6,<2.14" and needs["torch"].extra is None
    assert needs["viser"].extra is None and needs["drake"].extra == "drake"
    assert versions()["numpy"] == np.__version__


@pytest.mark.parametrize(
    ("bounds", "problem"),
    [(">=1.26,<3", ""), (">=999", "too old"), ("<1", "too new"), ("", ""), (f">={np.__version__}", "")],
)
def test_versions_are_compared_as_numbers(bounds: str, problem: str):
    assert Requirement("numpy", bounds).problem == problem


def test_a_missing_package_is_missing():
    assert Requirement("no-such-package", ">=1").problem == "missing"
