"""The errors that a user can cause, each with a message that says what to do about it.

Whatever a file, an argument or a mesh can get wrong is raised as a `GraspRefineError`; the command line
prints its message in one line and exits with code 2. Anything else that escapes is a defect of ours.
"""


class GraspRefineError(Exception):
    """An input or a request that cannot be used; the message names the value and the valid choices."""


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
