"""Assertions on refusals: their type, that they are one line, and the values and choices that they name."""

from __future__ import annotations

from types import TracebackType

import pytest
from jaxtyping import TypeCheckError


class refused:  # noqa: N801 - read as a statement: with refused(GraspFileError, "apple.obj"): ...
    """Expect an error of one line that names each of `named`: files, options, numbers, joints, choices.

    Where annotations are checked at each call, the checks refuse another type first.
    """

    def __init__(self, kind: type[BaseException], *named: object) -> None:
        self._raises, self._named = pytest.raises((kind, TypeCheckError)), named

    def __enter__(self) -> pytest.ExceptionInfo[BaseException]:
        self._caught = self._raises.__enter__()
        return self._caught

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        held = bool(self._raises.__exit__(kind, error, trace))
        if held and not isinstance(error, TypeCheckError):
            assert_names(str(self._caught.value), *self._named)
        return held


def assert_names(message: str, *named: object) -> None:
    """Assert that a message is one line that names each of `named`."""
    line = message.strip()
    assert "\n" not in line, f"not one line: {line}"
    missing = [str(one) for one in named if str(one) not in line]
    assert not missing, f"{missing} not named in: {line}"
