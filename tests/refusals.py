"""What tests ask of a refusal: its type, that it is one line, and the values and choices that it names; not its prose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def refused(kind: type[BaseException], *named: object) -> Iterator[pytest.ExceptionInfo[BaseException]]:
    """Expect an error of one line that names each of `named`: files, options, numbers, joints, choices."""
    with pytest.raises(kind) as caught:
        yield caught
    assert_names(str(caught.value), *named)


def assert_names(message: str, *named: object) -> None:
    """Assert that a message is one line that names each of `named`."""
    line = message.strip()
    assert "\n" not in line, f"not one line: {line}"
    missing = [str(one) for one in named if str(one) not in line]
    assert not missing, f"{missing} not named in: {line}"
