"""Errors that a user can cause, each with a message that names the remedy.

Every fault of a file, an argument or a mesh is raised as a `GraspRefineError`; the command line prints its message in
one line and exits with code 2. Any other exception that escapes is a bug of this package.
"""

import unicodedata
from collections.abc import Iterable
from reprlib import Repr

MAX_MESSAGE_CHARACTERS = 4000
"""Most characters of a message; cuts off endless lists and numbers out of files."""


class GraspRefineError(Exception):
    """An input or a request that cannot be used; the message names the value and the valid choices.

    The message is one printable line, even where it quotes an untrusted file.
    """

    def __init__(self, message: str) -> None:
        """Store the message, with spaces for line breaks and escapes for other unprintable characters."""
        message = visible(" ".join(str(message).splitlines()))
        super().__init__(
            message if len(message) <= MAX_MESSAGE_CHARACTERS else f"{message[: MAX_MESSAGE_CHARACTERS - 4]} ..."
        )


class MeshError(GraspRefineError):
    """A mesh that is missing, empty, not finite, flat, or cannot be made watertight."""


class HandError(GraspRefineError):
    """A hand description (URDF, hand.toml) that is missing, malformed or inconsistent."""


class GraspFileError(GraspRefineError):
    """A grasp file that is missing, malformed, or made for another hand or object."""


class ConventionError(GraspFileError):
    """A grasp file that most likely uses other units, quaternions or frames than assumed."""


class AssetError(GraspRefineError):
    """An asset, object or hand name that is not known here."""


class CollisionError(GraspRefineError):
    """A collision query that no tolerance could answer, or poses that are not finite."""


def quote_value(value: object) -> str:
    """Return a value out of a file for a message: its `repr`, of bounded length and depth."""
    try:
        return _SHORT_REPR.repr(value)
    except ValueError:
        return "an integer of thousands of digits"


def did_you_mean(name: str, known: Iterable[str], *, most: int = 1, otherwise: str = ";") -> str:
    """Return the part of a message that names up to `most` similar ones of the known names, or else a punctuation.

    Case does not count.
    """
    from difflib import get_close_matches

    by_folded = {one.casefold(): one for one in reversed(list(known))}
    close = [by_folded[one] for one in get_close_matches(name.casefold(), [*reversed(by_folded)], n=most)]
    return f", did you mean {' or '.join(close)}?" if close else otherwise


_SHORT_REPR = Repr()
_SHORT_REPR.maxstring = _SHORT_REPR.maxother = 200
_SHORT_REPR.maxlevel = 3


def visible(text: str) -> str:
    """Return `text` safe for a terminal: spaces for tabs and wide spaces, escapes for unprintable characters."""
    return text if text.isprintable() else "".join(map(_visible_character, text))


def _visible_character(character: str) -> str:
    if character.isprintable():
        return character
    return " " if character == "\t" or unicodedata.category(character) == "Zs" else ascii(character)[1:-1]
