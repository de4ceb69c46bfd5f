"""Linkages of an MJCF, whose chains are closed by connect equalities: passive joints as functions of the driven one.

A hand is a tree of joints. Where equalities close chains and an actuator drives one joint of them, the others follow
it: for values of the driven joint over its range, the others take values at which the chains are closed and the springs
at the joints are at rest as nearly as the limits allow, found by bounded least squares. Polynomials through them, whose
degree is the least that is exact enough, are the couplings of the hand.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.plurals import count_text
from grasp_refine.hands.linkages.yielding import YieldingMode

NUM_VALUES = 33
"""Number of values of a driven joint at which its linkage is solved."""

CLOSURE_WEIGHT = 1e4
"""Weight of a metre between the ends of a chain, or a radian off an equality of joints, against a spring's square root
of energy: springs of a hand pull chains apart by less than a micrometre."""

NEARNESS = 1e-4
"""Weight of a radian from the last solution, which decides where springs do not."""

CLOSED_M = 2e-5
"""Largest distance in metres between the ends of a closed chain."""

MAX_DEGREE, CURVE_ERROR = 4, 1e-6
"""Largest degree of a polynomial, as in MuJoCo's equalities, and error in rad or m at which a lower degree is
enough."""

SPRING_PREFERENCE = 10.0
"""Weight of joints with springs where a joint is chosen to represent a mode."""

TIE = 1e-3
"""Share by which columns differ in length that count as equally long."""

AT_LIMIT = 1e-3
"""Distance in rad or m from its limit within which a joint is at it."""

MOVING_SHARE = 1e-3
"""Least movement of a joint or a body that a mode moves, in units of the mode or of its largest."""

MIN_RANGE_SHARE = 0.05
"""Least share of its range over which a driven joint must close the chains."""


@dataclass(frozen=True, eq=False)
class Linkage:
    """Passive joints that follow a driven one; names and values of the model."""

    driver: str
    """Name of the driven joint."""
    range: tuple[float, float]
    """Values in rad or m of the driven joint at which the chains can be closed."""
    coefficients: Mapping[str, tuple[float, ...]]
    """Passive joint -> coefficients of its polynomial in the value of the driven joint, the constant first."""
    tied: Mapping[str, tuple[float, ...]]
    """Joints that an equality ties to another joint of the linkage."""
    gap: float
    """Largest distance in metres between the ends of a chain with joints at these values."""
    modes: tuple[YieldingMode, ...]
    """Modes in which it yields while the driven joint stands still: closed chains do not hold their bodies."""

    def place(self, model: mujoco.MjModel, data: mujoco.MjData, value: float) -> None:
        """Set joints and poses of a model to where the chains are closed at a value of the driven joint."""
        data.qpos[:] = model.qpos0
        data.qpos[model.joint(self.driver).qposadr] = value
        for name, coefficients in {**self.coefficients, **self.tied}.items():
            data.qpos[model.joint(name).qposadr] = np.polynomial.polynomial.polyval(value, coefficients)
        mujoco.mj_kinematics(model, data)


@dataclass(frozen=True, eq=False)
class Linkages:
    """All linkages of a model, notes on chains that are left open, and the bodies that close them."""

    linkages: tuple[Linkage, ...] = ()
    open: tuple[str, ...] = ()
    """Notes on chains that are left open."""
    ends: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies that close the chains."""


def linkages(model: mujoco.MjModel, driven: Collection[str]) -> Linkages:
    """Solve the linkages of a model.

    Args:
        model: A compiled model, all of whose joints have names.
        driven: Joints that actuators move, directly or through a tendon.
    """
    chains = [number for number in range(model.neq) if model.eq_type[number] == mujoco.mjtEq.mjEQ_CONNECT]
    if not chains:
        return Linkages()
    ties = _ties(model)
    found, notes = [], []
    pairs = (_bodies(model, number) for number in chains)
    ends = tuple((model.body(first).name, model.body(second).name) for first, second in pairs)
    for joints, equalities in _components(model, chains, ties):
        names = [model.joint(joint).name for joint in sorted(joints)]
        free = joints - {int(model.eq_obj1id[number]) for number in ties}
        drivers = [joint for joint in sorted(free) if model.joint(joint).name in driven]
        if len(drivers) != 1:
            who = ", ".join(model.joint(joint).name for joint in drivers) or "none"
            notes.append(f"a closed chain of {', '.join(names)} stays open: one of its joints must be driven, is {who}")
            continue
        inner = [number for number in ties if {int(model.eq_obj1id[number]), int(model.eq_obj2id[number])} <= joints]
        solved = _Closing(model, drivers[0], sorted(joints - {drivers[0]}), equalities, inner).solve()
        if solved is None:
            notes.append(f"a closed chain of {', '.join(names)} stays open: no value of its driven joint closes it")
        else:
            found.append(solved)
    return Linkages(tuple(found), tuple(notes), ends)


def linkage_note(linkage: Linkage, file: str) -> str:
    """Text for the user on a linkage that was solved."""
    curved = sum(len(coefficients) > 2 for coefficients in linkage.coefficients.values())
    yielding = ", ".join(mode.joint for mode in linkage.modes)
    return (
        f"closed chains of {file}: {', '.join(linkage.coefficients)} follow '{linkage.driver}' "
        f"({count_text(curved, 'curve')}), which keeps the chains closed within {linkage.gap * 1e3:.2g} mm"
        + (f"; {yielding} can move while it stands still, and only springs and limits hold them" if yielding else "")
    )


def _ties(model: mujoco.MjModel) -> list[int]:
    """Numbers of the active equalities between two joints."""
    of_two = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_obj2id >= 0) & model.eq_active0.astype(bool)
    return [int(number) for number in np.flatnonzero(of_two)]


def _bodies(model: mujoco.MjModel, equality: int) -> tuple[int, int]:
    """Numbers of the bodies that a connect equality ties."""
    first, second = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
        return int(model.site_bodyid[first]), int(model.site_bodyid[second])
    return first, second


def _components(
    model: mujoco.MjModel, chains: Collection[int], ties: Collection[int]
) -> list[tuple[set[int], list[int]]]:
    """Joints that closed chains and equalities of joints connect, each with the chains' equalities."""

    def above(body: int) -> set[int]:
        found: set[int] = set()
        while body > 0:
            found |= set(range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]))
            body = int(model.body_parentid[body])
        return found

    parts: list[tuple[set[int], list[int]]] = []
    for number in chains:
        if model.eq_active0[number]:
            first, second = (above(body) for body in _bodies(model, number))
            parts.append((first ^ second, [number]))
    parts += [({int(model.eq_obj1id[number]), int(model.eq_obj2id[number])}, []) for number in ties]
    merged: list[tuple[set[int], list[int]]] = []
    for joints, equalities in parts:
        near = [part for part in merged if part[0] & joints]
        merged = [part for part in merged if not part[0] & joints]
        together = [*near, (joints, equalities)]
        merged.append((set().union(*(part[0] for part in together)), [each for part in together for each in part[1]]))
    # In the order of the file, whatever was merged with what.
    merged.sort(key=lambda part: min(part[0], default=-1))
    return [(joints, sorted(equalities)) for joints, equalities in merged if equalities]


@dataclass(eq=False)
class _Closing:
    """Closed chains of a model with one driven joint."""

    model: mujoco.MjModel
    driver: int
    passive: list[int]
    chains: list[int]
    ties: list[int]

    def __post_init__(self) -> None:
        self.data = mujoco.MjData(self.model)
        self.at = self.model.jnt_qposadr[self.passive]
        limited = self.model.jnt_limited[self.passive].astype(bool)
        lower, upper = self.model.jnt_range[self.passive].T
        self.lower, self.upper = np.where(limited, lower, -np.inf), np.where(limited, upper, np.inf)

    def solve(self) -> Linkage | None:
        """The linkage; None where the chains cannot be closed over a range."""
        model = self.model
        first = float(model.qpos0[model.jnt_qposadr[self.driver]])
        low, high = model.jnt_range[self.driver] if model.jnt_limited[self.driver] else (first - np.pi, first + np.pi)
        values = np.linspace(low, high, NUM_VALUES)
        start = int(np.abs(values - first).argmin())
        solved = np.full((NUM_VALUES, len(self.passive)), np.nan)
        for way in (range(start, NUM_VALUES), range(start, -1, -1)):
            x = model.qpos0[self.at] if np.isnan(solved[start]).any() else solved[start]
            for row in way:
                x = self._closed(float(values[row]), x)
                if self._gap(float(values[row]), x) > CLOSED_M:
                    break
                solved[row] = x
        good = ~np.isnan(solved).any(axis=1)
        if good.sum() < MIN_RANGE_SHARE * NUM_VALUES:
            return None
        values, solved = values[good], solved[good]
        followers = {int(model.eq_obj1id[number]) for number in self.ties}
        fits = [_fit(values, column) for column in solved.T]
        fitted = np.stack([np.polynomial.polynomial.polyval(values, fit) for fit in fits], axis=1)
        coefficients, tied = (
            {
                model.joint(joint).name: tuple(fit.tolist())
                for joint, fit in zip(self.passive, fits, strict=True)
                if (joint in followers) == follows
            }
            for follows in (False, True)
        )
        return Linkage(
            driver=model.joint(self.driver).name,
            range=(float(values[0]), float(values[-1])),
            coefficients=coefficients,
            tied=tied,
            modes=self._modes(values, fitted),
            gap=max(self._gap(float(value), x) for value, x in zip(values, fitted, strict=True)),
        )

    def _closed(self, value: float, x: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """Values of the passive joints at which the chains are closed, near `x`."""
        from scipy.optimize import least_squares

        stiffness = np.sqrt(self.model.jnt_stiffness[self.passive])
        rest = self.model.qpos_spring[self.at]

        def residuals(at: np.ndarray) -> np.ndarray:
            springs = stiffness * (at - rest)
            return np.concatenate([CLOSURE_WEIGHT * self._errors(value, at), springs, NEARNESS * (at - x)])

        width = np.maximum(self.upper - self.lower, 1e-9)
        inside = np.clip(x, self.lower + 1e-9 * np.minimum(width, 1.0), self.upper - 1e-9 * np.minimum(width, 1.0))
        found = least_squares(residuals, inside, bounds=(self.lower, self.upper), xtol=1e-13, ftol=1e-13, gtol=1e-13)
        return np.asarray(found.x)

    def _errors(self, value: float, x: Float[np.ndarray, " p"]) -> Float[np.ndarray, " r"]:
        """Vectors between the ends of the chains in metres, and errors of the equalities of joints in rad or m."""
        model, data = self.model, self.data
        self._place(value, x)
        errors = []
        for number in self.chains:
            first, second = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
            if model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_SITE:
                errors.append(data.site_xpos[first] - data.site_xpos[second])
                continue
            anchors = model.eq_data[number, :6].reshape(2, 3)
            a, b = (
                data.xpos[body] + data.xmat[body].reshape(3, 3) @ anchor
                for body, anchor in zip((first, second), anchors, strict=True)
            )
            errors.append(a - b)
        for number in self.ties:
            one, two = (model.jnt_qposadr[int(each[number])] for each in (model.eq_obj1id, model.eq_obj2id))
            power = (data.qpos[two] - model.qpos0[two]) ** np.arange(5)
            errors.append(data.qpos[one] - model.qpos0[one] - np.atleast_1d(model.eq_data[number, :5] @ power))
        return np.concatenate(errors)

    def _place(self, value: float, x: Float[np.ndarray, " p"]) -> None:
        """Set the joints and poses of `data`."""
        self.data.qpos[:] = self.model.qpos0
        self.data.qpos[self.at] = x
        self.data.qpos[self.model.jnt_qposadr[self.driver]] = value
        mujoco.mj_kinematics(self.model, self.data)

    def _modes(self, values: Float[np.ndarray, " K"], fitted: Float[np.ndarray, "K p"]) -> tuple[YieldingMode, ...]:
        """Modes of the passive joints that keep the chains closed, to first order, at values of the driven joint."""
        model = self.model
        ways = [self._free_ways(float(value), x) for value, x in zip(values, fitted, strict=True)]
        D = min(len(way) for way in ways)
        middle = ways[len(ways) // 2]
        if D == 0 or len(middle) != D:
            return ()
        stiffness = model.jnt_stiffness[self.passive]
        # Joints with springs have the values of modes, so that each finger has a mode of its own.
        own = _leading_columns(middle * np.where(stiffness > 0.0, SPRING_PREFERENCE, 1.0))
        Z = np.stack([np.linalg.lstsq(way[:, own], np.eye(D), rcond=None)[0] @ way for way in ways])
        twists = self._twists(values, fitted, Z)
        torque = -stiffness * (fitted - model.qpos_spring[self.at])
        springs, soft = np.einsum("kdp,kp->kd", Z, torque), np.einsum("kdp,p->kd", Z**2, stiffness)
        # A joint at a limit is pushed away from it with as much as it takes.
        away = (fitted < self.lower + AT_LIMIT).astype(int) - (fitted > self.upper - AT_LIMIT).astype(int)
        pushed = Z * away[:, None]
        moving = np.abs(Z) > MOVING_SHARE
        more, less = (np.any(moving & (sign * pushed > 0.0), axis=2) for sign in (1.0, -1.0))
        names = [model.body(body).name for body in range(model.nbody)]
        found = []
        for d in range(D):
            moved = np.flatnonzero((np.abs(twists[:, d]) > MOVING_SHARE * np.abs(twists[:, d]).max()).any(axis=(0, 2)))
            found.append(
                YieldingMode(
                    joint=model.joint(self.passive[own[d]]).name,
                    driver=model.joint(self.driver).name,
                    values=values,
                    twists={names[body]: twists[:, d, body] for body in moved},
                    least=np.where(less[:, d], -np.inf, springs[:, d]),
                    greatest=np.where(more[:, d], np.inf, springs[:, d]),
                    stiffness=soft[:, d],
                )
            )
        return tuple(found)

    def _twists(
        self, values: Float[np.ndarray, " K"], fitted: Float[np.ndarray, "K p"], Z: Float[np.ndarray, "K D p"]
    ) -> Float[np.ndarray, "K D bodies 6"]:
        """Twists of all bodies in their own frames while the passive joints move by `Z`."""
        model, data = self.model, self.data
        dofs, jacobian = model.jnt_dofadr[self.passive], np.zeros((2, 3, model.nv))
        found = np.zeros((*Z.shape[:2], model.nbody, 6))
        for k, (value, x) in enumerate(zip(values, fitted, strict=True)):
            self._place(float(value), x)
            mujoco.mj_comPos(model, data)
            for body in range(1, model.nbody):
                mujoco.mj_jacBody(model, data, jacobian[0], jacobian[1], body)
                in_body = data.xmat[body].reshape(3, 3).T @ jacobian[:, :, dofs]
                found[k, :, body] = np.moveaxis(in_body @ Z[k].T, 2, 0).reshape(-1, 6)
        return found

    def _free_ways(self, value: float, x: Float[np.ndarray, " p"]) -> Float[np.ndarray, "d p"]:
        """Orthonormal rows: changes of the passive joints that keep the chains closed, to first order."""
        steps = 1e-6 * np.eye(len(x))
        J = np.stack([self._errors(value, x + dx) - self._errors(value, x - dx) for dx in steps], axis=1) / 2e-6
        _, singular, ways = np.linalg.svd(J)
        return ways[(singular > 1e-4 * singular[0]).sum() :]

    def _gap(self, value: float, x: Float[np.ndarray, " p"]) -> float:
        """Largest distance in metres between the ends of a chain."""
        vectors = self._errors(value, x)[: 3 * len(self.chains)].reshape(-1, 3)
        return float(np.linalg.norm(vectors, axis=1).max())


def _leading_columns(A: Float[np.ndarray, "D p"]) -> list[int]:
    """Indices of D columns that are independent of each other, ascending: repeatedly the longest one that is left.

    Of columns that are equally long up to `TIE`, as for mirrored fingers, the first is taken.
    """
    found: list[int] = []
    for _ in range(len(A)):
        length = np.linalg.norm(A, axis=0)
        longest = int(np.flatnonzero(length >= (1.0 - TIE) * length.max())[0])
        along = A[:, longest] / length[longest]
        A = A - np.outer(along, along @ A)
        found.append(longest)
    return sorted(found)


def _fit(x: Float[np.ndarray, " K"], y: Float[np.ndarray, " K"]) -> Float[np.ndarray, " d"]:
    """Coefficients of the polynomial of least degree that is exact enough, the constant first; at least two."""
    for degree in range(MAX_DEGREE + 1):
        fit = np.polynomial.Polynomial.fit(x, y, degree)
        if degree == MAX_DEGREE or np.abs(fit(x) - y).max() <= CURVE_ERROR:
            break
    return np.pad(fit.convert().coef, (0, max(0, 2 - degree - 1)))
