"""Registry of named entries: ours, entries of installed packages by entry points, and entries added by a script."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import entry_points
from typing import Generic, TypeVar, overload

from grasp_refine.core.errors import GraspRefineError

Entry = TypeVar("Entry")


class Registry(Generic[Entry]):
    """Entries in order: ours first. Entry points are loaded when something beyond ours is first asked for."""

    def __init__(
        self,
        kind: str,
        group: str,
        ours: Iterable[Entry],
        *,
        name_of: Callable[[Entry], str],
        check: Callable[[Entry], None],
        error: type[GraspRefineError] = GraspRefineError,
    ) -> None:
        """Begin with our own entries.

        Args:
            kind: Noun for messages, such as "format".
            group: Group of entry points, such as "grasp_refine.formats".
            ours: Our own entries.
            name_of: Returns the name of an entry.
            check: Raises a `GraspRefineError` for a value that is no usable entry.
            error: Class of the error for an unknown name.
        """
        self.kind, self.group, self.error = kind, group, error
        self.name_of, self._check = name_of, check
        self._ours = {name_of(entry): entry for entry in ours}
        self._installed: dict[str, Entry] | None = None
        self._added: dict[str, Entry] = {}

    def __iter__(self) -> Iterator[Entry]:
        """Yield all entries, ours first.

        Raises:
            GraspRefineError: an entry point cannot be loaded, or is no usable entry.
        """
        return iter(self._all().values())

    def __len__(self) -> int:
        """Return the number of entries."""
        return len(self._all())

    def __getitem__(self, name: str) -> Entry:
        """Return the entry with a name.

        Raises:
            GraspRefineError: there is none; lists all names.
        """
        if name in self._ours:
            return self._ours[name]
        known = self._all()
        if name not in known:
            raise self.error(f"no {self.kind} '{name}'; the {self.kind}s are {', '.join(known)}")
        return known[name]

    def add(self, entry: Entry, *, replace: bool = False) -> None:
        """Add an entry of a script.

        Args:
            entry: The entry.
            replace: Whether it may take the place of one that a script has added under the same name.

        Raises:
            GraspRefineError: it is no usable entry, or its name is taken.
        """
        self._check(entry)
        name = self.name_of(entry)
        if name in self._all() and not (replace and name in self._added):
            advice = "; replace=True takes its place" if name in self._added else ""
            raise GraspRefineError(f"the name of {self.kind} '{name}' is taken{advice}")
        self._added[name] = entry

    def remove(self, name: str) -> None:
        """Remove an entry that a script has added.

        Raises:
            GraspRefineError: no script has added one with this name.
        """
        if name not in self._added:
            raise GraspRefineError(f"no {self.kind} '{name}' was added")
        del self._added[name]

    def view(self, select: Callable[[Iterable[Entry]], Iterable[Entry]]) -> View[Entry]:
        """Return the entries that a function selects from all, and orders; later additions are in it too."""
        return View(self, select)

    def _all(self) -> dict[str, Entry]:
        """Return all entries by name."""
        if self._installed is None:
            self._installed = {}  # a package may itself use the registry when it is loaded
            try:
                self._installed = self._load()
            except GraspRefineError:
                self._installed = None
                raise
        return self._ours | self._installed | self._added

    def _load(self) -> dict[str, Entry]:
        """Return the entries of installed packages by name."""
        found: dict[str, Entry] = {}
        for point in entry_points(group=self.group):
            owner = f"{point.value} of {point.dist.name if point.dist else 'a package'} ({self.group})"
            try:
                entry = point.load()
            except Exception as error:  # a package of others may fail in any way
                raise GraspRefineError(f"{owner} cannot be loaded: {type(error).__name__}: {error}") from error
            try:
                self._check(entry)
            except GraspRefineError as error:
                raise GraspRefineError(f"{owner}: {error}") from None
            name = self.name_of(entry)
            if name in self._ours or name in found or name in self._added:
                raise GraspRefineError(f"{owner}: the name of {self.kind} '{name}' is taken")
            found[name] = entry
        return found


class View(Sequence[Entry]):
    """Some entries of a registry, as they are at the time of use."""

    def __init__(self, registry: Registry[Entry], select: Callable[[Iterable[Entry]], Iterable[Entry]]) -> None:
        """Select entries of a registry by a function."""
        self._registry, self._select = registry, select

    def __iter__(self) -> Iterator[Entry]:
        """Yield the entries."""
        return iter(self._select(self._registry))

    def __len__(self) -> int:
        """Return the number of entries."""
        return len(tuple(iter(self)))

    @overload
    def __getitem__(self, place: int) -> Entry: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Entry]: ...
    def __getitem__(self, place: int | slice) -> Entry | Sequence[Entry]:
        """Return the entry at an index, or the entries of a slice."""
        return tuple(iter(self))[place]
