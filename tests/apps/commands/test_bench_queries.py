"""`refine-grasp bench queries` as a user meets it: tables, documents, and refusals."""

from __future__ import annotations

import pytest

from command_line import refused
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace", "threads")


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--preset smoke --batches 3", ("--preset smoke", "--batches")),
        ("--batches 0", ("--batches", "1", "0")),
        ("--pieces 1", ("--pieces", "2", "1")),
        ("--vertices 3", ("--vertices", "4", "3")),
        ("--no-skips --hands leap", ("--hands", "--objects", "--count", "--skips")),
        ("--batches 4 --objects mug", ("--hands", "--objects", "--count", "--skips")),
        ("--preset skips --no-skips", ("--preset skips", "--no-skips")),
        ("--preset skips --objects teapot", ("'allegro'", "'teapot'")),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "bench", "queries", *options.split()), *named)
