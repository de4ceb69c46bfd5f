"""The errors that a user can cause, each with a message that says what to do about it.

Whatever a file, an argument or a mesh can get wrong is raised as a `GraspRefineError`; the command line
prints its message in one line and exits with code 2. Anything else that escapes is a defect of ours.
"""

import unicodedata
from reprlib import Repr

LONGEST = 4000
"""Letters of a message that are kept; what is cut off are lists and numbers without end out of files."""


class GraspRefineError(Exception):
    """An input or a request that cannot be used; the message names the value and the valid choices.

    Whatever is in it of a file that may come from anyone, the message is one line that a terminal only shows.
    """

    def __init__(self, message: str) -> None:
        """Keep the message, with spaces for line breaks and escapes for other letters that nobody can see."""
        message = visible(" ".join(str(message).splitlines()))
        super().__init__(message if len(message) <= LONGEST else f"{message[: LONGEST - 4]} ...")


class MeshError(GraspRefineError):
    """A mesh that is missing, empty, not finite, flat, or cannot be made watertight."""


class HandError(GraspRefineError):
    """A hand description (URDF, hand.toml) that is missing, malformed or inconsistent."""


class GraspFileError(GraspRefineError):
    """A grasp file that is missing, malformed, or made for another hand or object."""


class AssetError(GraspRefineError):
    """An asset, object or hand name that is not known here."""


class CollisionError(GraspRefineError):
    """A collision query that no tolerance could answer, or poses that are not finite."""


def told(value: object) -> str:
    """A value out of a file, for a message: like `repr`, but of bounded length and depth."""
    try:
        return _TOLD.repr(value)
    except ValueError:
        return "a whole number of thousands of digits"


_TOLD = Repr()
_TOLD.maxstring = _TOLD.maxother = 200
_TOLD.maxlevel = 3


def visible(text: str) -> str:
    """Return `text` as a terminal may be sent it: spaces for tabs and wide spaces, escapes for what cannot be seen."""
    return text if text.isprintable() else "".join(map(_visible_character, text))


def _visible_character(character: str) -> str:
    if character.isprintable():
        return character
    return " " if character == "\t" or unicodedata.category(character) == "Zs" else ascii(character)[1:-1]
