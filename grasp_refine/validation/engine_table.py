"""Engines that simulate grasps, by name: one entry for each, and one name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

from grasp_refine.core.errors import GraspRefineError

if TYPE_CHECKING:
    from grasp_refine.validation.engines.mujoco.world import World
    from grasp_refine.validation.engines.simulations import Engine

EngineName = Literal["mujoco", "drake", "physx"]
"""Names of the engines, the keys of `ENGINES`."""

EngineChoice = EngineName | Literal["all"]
"""An engine, or all that are installed and simulate the hand and its task."""


@dataclass(frozen=True)
class EngineEntry:
    """Engine, loaded when it is first used: it knows worlds and trials, which do not know it."""

    title: str
    """Name for people."""
    module: str
    """Module whose `engine_for(world)` returns the `Engine` of a world, or refuses it by a GraspRefineError."""
    imports: str
    """Top-level module of its package."""
    package: str
    """Distribution of its package, whose version results record."""
    extra: str = ""
    """Extra of grasp-refine that installs the package; empty: it is always installed."""
    has_scenes: bool = False
    """Whether it simulates scenes."""
    has_arms: bool = False
    """Whether it simulates hands on an arm."""

    @property
    def version(self) -> str:
        """Installed version of its package."""
        return version(self.package)

    def load(self) -> Any:
        """Return its module.

        Raises:
            GraspRefineError: its package is not installed.
        """
        try:
            return import_module(self.module)
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] != self.imports:
                raise
            raise GraspRefineError(
                f"engine {self.title} is not installed: pip install 'grasp-refine[{self.extra}]'"
            ) from None


_ENGINES = "grasp_refine.validation.engines"

ENGINES: Mapping[EngineName, EngineEntry] = MappingProxyType(
    {
        "mujoco": EngineEntry(
            "MuJoCo", f"{_ENGINES}.mujoco.stepping", "mujoco", "mujoco", has_scenes=True, has_arms=True
        ),
        "drake": EngineEntry("Drake", f"{_ENGINES}.drake.rows", "pydrake", "drake", extra="drake"),
        "physx": EngineEntry("PhysX", f"{_ENGINES}.physx.rows", "sapien", "sapien", extra="physx"),
    }
)
"""Name -> engine; the first one is the default."""

MUJOCO: EngineName = "mujoco"
"""Engine that simulates everything."""


def check_engine(name: str) -> EngineEntry:
    """Return the entry of an engine.

    Raises:
        GraspRefineError: there is no such engine, or its package is not installed.
    """
    entry = next((entry for known, entry in ENGINES.items() if known == name), None)
    if entry is None:
        raise GraspRefineError(f"engines are {', '.join(ENGINES)}, got {name!r}")
    entry.load()
    return entry


def engine_of(name: str, world: World) -> Engine:
    """Return an engine for simulations of a world.

    Raises:
        GraspRefineError: there is no such engine, its package is not installed, or it does not simulate this hand, arm
            or scene.
    """
    entry = check_engine(name)
    others = ", ".join(other for other, each in ENGINES.items() if each.has_scenes and each.has_arms)
    if world.scene and not entry.has_scenes:
        raise GraspRefineError(
            f"engine {name} does not simulate scenes, as '{world.scene}': use {others}, or `scene='none'`"
        )
    if world.hand.on_arm is not None and not entry.has_arms:
        raise GraspRefineError(f"engine {name} simulates hands without an arm: use {others}")
    return entry.load().engine_for(world)


def chosen_engines(
    choice: Any, worlds: Sequence[World], on_note: Callable[[str], None] = lambda line: None
) -> tuple[EngineName, ...]:
    """Return the names of the chosen engines, in the order of the choice.

    Args:
        choice: Names, a sequence; "all" stands for all engines that are installed and simulate these worlds.
        worlds: The worlds.
        on_note: Called with the reason for each engine that "all" leaves out.

    Raises:
        GraspRefineError: an empty choice, or one of the chosen engines cannot be used.
    """
    if isinstance(choice, str) or not choice:
        raise GraspRefineError(f"engines are a sequence of {', '.join(ENGINES)}, or all, got {choice!r}")
    names = [name for name in choice if name != "all"]
    for name in names:
        check_engine(name)
    if "all" in choice:
        for name in ENGINES:
            try:
                check_engine(name)
                for world in worlds:
                    engine_of(name, world)
                names.append(name)
            except GraspRefineError as error:
                on_note(f"engine {name} is left out: {error}")
    return tuple(dict.fromkeys(names))
