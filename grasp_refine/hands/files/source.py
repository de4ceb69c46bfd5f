"""Files of a hand by its name: a folder of robots/, a path of the user's, or an asset."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.assets.locating import fetched
from grasp_refine.assets.manifest import read_manifest
from grasp_refine.assets.names import find_asset
from grasp_refine.assets.robot_descriptions import PREFIX, described
from grasp_refine.core.errors import AssetError, GraspFileError, HandError
from grasp_refine.core.names import exists, expand_user, is_file
from grasp_refine.hands.files.hand_toml import ARM_TOML, HAND_TOML, HandToml, only_file, read_hand_toml
from grasp_refine.hands.files.usd import is_usd, urdf_of_usd

ON_ARM = "_on_"
"""Separator of the names of a hand and its arm in the name of both."""


def list_hands() -> tuple[str, ...]:
    """Names of the hands that come with the program, each a folder of robots/ with a hand.toml."""
    return tuple(sorted(file.parent.name for file in resource_dir("robots").glob(f"*/{HAND_TOML}")))


def list_arms() -> tuple[str, ...]:
    """Names of the arms that come with the program, each a folder of robots/ with an arm.toml."""
    return tuple(sorted(file.parent.name for file in resource_dir("robots").glob(f"*/{ARM_TOML}")))


def needs_urdf(name: str) -> bool:
    """Return True if the hand `name` of `list_hands()` has no URDF of ours: it is fetched, or given by the user."""
    return read_hand_toml(resource_dir("robots") / name / HAND_TOML).file is None


def is_known(name: str) -> bool:
    """Return True if `name` is one of `list_hands()`, or the full name of an asset such as hands/leap."""
    return name in list_hands() or name in (asset.full_name for asset in read_manifest("hands").values())


def check_known(name: str, file: Path) -> None:
    """Refuse an unknown hand `name` of the grasp file `file`.

    Raises:
        GraspFileError: the hand is unknown, so that the user has to give it.
    """
    if not is_known(name):
        ours = ", ".join(list_hands())
        hand, on_arm, arm = name.partition(ON_ARM)
        how = f"`hand='{hand}'` and `arm='{arm}'`" if on_arm else "`hand`"
        raise GraspFileError(f"{file}: its hand '{name}' is not one of ours ({ours}); give it with {how}")


def hand_files(
    source: str | Path, urdf: Path | None, mjcf: Path | None, on_message: Callable[[str], None]
) -> tuple[str, HandToml]:
    """The hand's name, and its hand.toml, or one that only names its files, with a URDF or an MJCF in any case.

    Args:
        source: One of `list_hands()`, a folder, a URDF or MJCF file, a hand.toml, an asset, as `hands/leap`: its
            files, and what our hand.toml of that name adds to them; or robot_descriptions/NAME.
        urdf: Used instead of the URDF that hand.toml names. Where neither gives one, that of the asset is used.
        mjcf: Used instead of the MJCF that hand.toml names: a file, or an asset such as shadow_mjcf.
        on_message: Called with a line on each download.

    Raises:
        AssetError: no such name, or an asset that cannot be fetched.
        HandError: a file is missing or malformed.
    """
    name, toml = _locate(source, urdf, on_message)
    if toml.file is None:
        asset = find_asset(name, "hands")
        if asset is None:
            raise HandError(f"hand '{name}' comes without a URDF: give yours with `urdf=FILE`")
        try:
            toml = replace(toml, file=fetched(asset, on_message))
        except AssetError as error:
            raise AssetError(f"hand '{name}' comes without a URDF: give yours with `urdf=FILE`, or: {error}") from None
    if mjcf is not None:
        path = expand_user(mjcf)
        asset = None if is_file(path) or path.name != str(path) else find_asset(str(mjcf), "hands")
        path = path if asset is None else fetched(asset, on_message)
        if not is_file(path):
            raise HandError(f"{mjcf}: no such MJCF file")
        toml = replace(toml, mjcf=path)
    return name, toml


def _locate(source: str | Path, urdf: Path | None, on_message: Callable[[str], None]) -> tuple[str, HandToml]:
    """Name and hand.toml as from `hand_files`, but without a URDF where a hand of ours has none."""
    if isinstance(source, str) and source in (*list_hands(), *list_arms()):
        source = resource_dir("robots") / source
    path = expand_user(Path(source))
    if isinstance(source, str) and source.startswith(PREFIX) and not exists(path):
        full_name, file = described(source, on_message)
        return full_name, HandToml(file, file)
    if not exists(path):
        if isinstance(source, str) and source.lower() in (*list_hands(), *list_arms()):
            # Not the asset of that name, which is another model.
            raise AssetError(f"no hand or arm '{source}', did you mean {source.lower()}?")
        asset = find_asset(source, "hands") if isinstance(source, str) else None
        if asset is not None:
            ours = resource_dir("robots") / asset.name / HAND_TOML
            urdf = fetched(asset, on_message) if urdf is None else urdf
            toml = replace(read_hand_toml(ours), file=urdf) if ours.is_file() else HandToml(urdf, urdf)
            # Not the name of ours: grasps refined with the one must not be validated with the other.
            return asset.full_name, toml
        choices = (
            f"the hands here are {', '.join(list_hands())}, the arms {', '.join(list_arms())}; or give a folder, a "
            f"URDF or MJCF file, a {HAND_TOML}, an asset (refine-grasp assets list hands), or {PREFIX}NAME"
        )
        if isinstance(source, str) and path.name == source and not path.suffix:
            raise AssetError(f"no hand or arm '{source}'; {choices}")
        raise HandError(f"{path}: no such file or folder; {choices}")
    folder = path if path.is_dir() else path.parent
    beside = next((folder / name for name in (HAND_TOML, ARM_TOML) if is_file(folder / name)), folder / HAND_TOML)
    if beside.is_file():
        toml = read_hand_toml(beside)
        named = path.is_dir() or path.samefile(beside)
        if named or (toml.file is not None and path.samefile(toml.file)):
            return folder.resolve().name, toml if urdf is None else replace(toml, file=urdf)
    if urdf is not None:
        raise HandError(f"`urdf={urdf}`: goes with a hand that has a {HAND_TOML}, '{source}' has none")
    file = only_file(path) if path.is_dir() else path
    if is_usd(file):
        file = urdf_of_usd(file)
    return (folder.resolve().name if path.is_dir() else path.stem), HandToml(file, file)
