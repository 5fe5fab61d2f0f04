"""Slices of logs: filtered rows of every joint, a lot of which reductions of a log share."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from geodrake.compiling import contiguous
from geodrake.effects.base import Effect
from geodrake.effects.declarations import Role
from geodrake.effects.effect_columns import EffectColumns, declares_signals
from geodrake.effects.robot_motion import log_number
from geodrake.effects.sensors import delayed_by
from geodrake.identification.logs.contact_rows import (
    MixedRows,
    add_weighted,
    contact_rows,
    row_scales,
)
from geodrake.identification.logs.dataset import Indices, JointRows, column_starts, is_payload
from geodrake.logs.filtering import spline_through
from geodrake.logs.motion import MEMORY, Motion, Trajectory
from geodrake.logs.smoothing import SPLINE_REACH, Segment, Stretch
from geodrake.model.carried_payloads import carried_phi, carrying
from geodrake.model.robot_model import RobotModel
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.regressor import inverse_dynamics, inverse_dynamics_regressor, regressor_pieces

Array = NDArray[np.float64]
Part = Effect | str
"""Owner of columns: an effect, or `INERTIA`."""

Blocks = Mapping[int, Array]
"""Columns (K, k) by the index of the joint."""

ROOM = 10_000_000
"""Reductions of the same logs share at most so many numbers: 80 MB."""

MIXED_ROOM = 30_000_000
"""The same with unknown contact forces, where rows of the base depend on all joints."""

SIGNALS_ROOM = 2_000_000
"""At most so many of them are signals at the logs' full rate; filtered columns cost more."""


class RowCache:
    """Cache that reductions of the same logs and robot share.

    The columns of an effect do not depend on what else is tried, so that only those have to be
    evaluated that no reduction had before. When there is no more room for so many numbers, what no
    reduction has used for longest makes room; what this one or the last one used stays, as the next
    one most often needs the same. Of `signals` at the full rate, which only further columns need,
    no more is kept then.
    """

    def __init__(self, room: int = ROOM, *, signals: int = SIGNALS_ROOM) -> None:
        self._room, self._signals, self._kept = room, signals, dict[Hashable, Blocks]()
        self._used, self._turn, self._stale = dict[Hashable, int](), 0, list[Hashable]()

    def begin(self) -> None:
        """Begin another reduction."""
        self._turn += 1
        self._stale = sorted(self._used, key=self._used.__getitem__, reverse=True)

    def get(self, key: Hashable) -> Blocks | None:
        """Return the cached value of a key, or None."""
        if key in self._used:
            self._used[key] = self._turn
        return self._kept.get(key)

    def once(self, key: Hashable, make: Callable[[], Blocks], *, signals: bool = False) -> Blocks:
        """Return the cached value of a key, or compute and cache it; `signals` as in `keep`."""
        if (found := self.get(key)) is None:
            self.keep(key, found := make(), signals=signals)
        return found

    def read_only(self) -> RowCache:
        """Return the cache for reductions whose columns are not needed again."""
        reader = RowCache(0)
        reader._kept = self._kept
        return reader

    def keep(self, key: Hashable, blocks: Blocks, *, signals: bool = False) -> None:
        """Cache blocks within the limit; `signals` are at the full rate."""
        if (size := _size(blocks)) == 0 or key in self._kept:
            return
        while size > self._room and self._stale and not signals:
            if self._used[old := self._stale.pop()] < self._turn - 1:
                self._room += _size(self._kept.pop(old))
                del self._used[old]
        if size <= (min(self._room, self._signals) if signals else self._room):
            self._room -= size
            self._signals -= size if signals else 0
            self._kept[key] = {at: np.array(block) for at, block in blocks.items()}
            if not signals:
                self._used[key] = self._turn


def _size(blocks: Blocks) -> int:
    return sum(block.size for block in blocks.values())


INERTIA = "inertia"
"""Owner of the columns of inertial parameters."""

_OWN = -1  # where rows that are velocities' own stand among those of contacts
_FELT = 0.02  # share of a row's noise from which the friction of a joint at rest matters to it

_OTHERS = frozenset({"load", "bodies"})
"""Signals that are not of the motion alone."""

MOSTLY_STILL = 0.3
"""A joint's sample is left out if it is at rest in more than this share of the filter's window.

Dry friction can then be anything up to breakaway, and no model of the motion says what.
"""


@dataclass(frozen=True, eq=False)
class Layout:
    """Which columns each joint has, and how they are computed."""

    model: RobotModel
    effects: tuple[Effect, ...]  # effects that have columns
    sign_width: Array  # (nv,) speed below which the direction of motion is not known
    still_speed: Array  # (nv,) speed below which a joint counts as at rest
    columns: tuple[Indices, ...]  # per joint, the global indices of its columns
    # (nv, nv) which joints rows have in them, where unknown contact forces are taken out.
    coupling: NDArray[np.bool_] | None = None

    @classmethod
    def of(
        cls,
        model: RobotModel,
        effects: tuple[Effect, ...],
        sign_width: Array,
        still_speed: Array,
        *,
        coupling: NDArray[np.bool_] | None = None,
    ) -> Layout:
        """Return the layout of the columns of bodies and effects; speeds (nv,) in rad/s or m/s.

        Where unknown contact forces are taken out, rows have columns of the joints in them, by
        their `coupling` (nv, nv).
        """
        motion = _probe(model, 7)
        size = np.abs(
            inverse_dynamics_regressor(_felt(model, effects)[0], motion.q, motion.v, motion.vd)
        ).max(axis=0)
        inertial = size > 1e-12 * size.max(initial=1e-300)  # what can matter at a joint
        starts = column_starts(effects, model.bodies)
        if coupling is not None:
            inertial = coupling @ inertial
        columns = [[np.flatnonzero(inertial[j])] for j in range(len(model.joints))]
        own = tuple(effect for effect in effects if not is_payload(effect))
        probe = model.motion(_probe(model, 1), sign_width=1.0)
        rows = EffectColumns(model.joints, own).fit_rows(probe)
        for effect, blocks in zip(own, rows, strict=True):
            indices = starts[effect] + np.arange(len(effect.parameters))
            felt = blocks if coupling is None else np.flatnonzero(coupling[:, [*blocks]].any(1))
            for joint in felt:
                columns[joint].append(indices)
        joined = tuple(np.concatenate(c) for c in columns)
        return cls(model, effects, sign_width, still_speed, joined, coupling=coupling)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Owners of columns, in their order."""
        return (INERTIA, *(effect for effect in self.effects if not is_payload(effect)))

    def places(self, part: Part, columns: Indices, row: int) -> Indices:
        """Return where columns of a part are among those that it has in a row; −1 where nowhere."""
        if isinstance(part, Effect):
            return columns
        own = self.bodies[row]
        return np.where(np.isin(columns, own), np.searchsorted(own, columns), -1)

    def width(self, part: Part, row: int) -> int:
        """Return how many columns a part has in a row."""
        return len(part.parameters) if isinstance(part, Effect) else len(self.bodies[row])

    @cached_property
    def bodies(self) -> list[Indices]:
        """Which columns of bodies each joint has."""
        return [c[c < self.model.phi.size] for c in self.columns]

    @property
    def tree(self) -> KinematicTree:
        """The tree with which columns of bodies are computed, with the gravity on them."""
        return self._felt[0]

    @cached_property
    def _felt(self) -> tuple[KinematicTree, Effect | None]:
        return _felt(self.model, self.effects)

    def in_bodies(self, joint: int, blocks: Mapping[Effect, Blocks]) -> Array | float:
        """Return (K,) effort of effects that a joint's columns of bodies contain; 0 without."""
        effect = self._felt[1]
        if effect is None or joint not in blocks[effect]:
            return 0.0
        return np.asarray(blocks[effect][joint] @ effect.in_bodies)

    def blocks_in_bodies(self, blocks: Sequence[Blocks]) -> dict[Effect, Blocks]:
        """Return what `in_bodies` needs of the columns of all parts."""
        effect = self._felt[1]
        return {} if effect is None else {effect: blocks[self.parts.index(effect)]}

    @cached_property
    def origins(self) -> list[tuple[Part, Hashable]]:
        """Each part with the dependencies of its columns other than the motion."""
        widths, found = self.sign_width.tobytes(), list[tuple[Part, Hashable]]()
        for part in self.parts:
            if isinstance(part, Effect):
                of_motion = declares_signals(type(part)) and not part.depends_on & _OTHERS
                found.append((part, widths if of_motion else self._origin))
            else:
                found.append((part, self.tree.gravity.tobytes()))
        return found

    @cached_property
    def _origin(self) -> Hashable:
        """The model's efforts, and widths."""
        effects = tuple(
            (fitted.effect, np.asarray(fitted.parameters).tobytes())
            for fitted in self.model.effects
            if fitted.effect.parameters
        )
        return self.model.total_phi.tobytes(), effects, self.sign_width.tobytes()

    def evaluate(
        self,
        motion: Motion,
        trajectory: Trajectory,
        parts: Collection[Part],
        load: Array | None = None,
    ) -> tuple[list[Blocks], Array]:
        """Return unfiltered columns of some parts at a log's motion, and the load (N, nv).

        That is the effort of the bodies with what they hold, which may be known already.
        """
        robot, inertial = carrying(self.model, trajectory.payloads), dict[int, Array]()
        if INERTIA in parts:
            inertial, needed = self._inertial_at(motion, robot.total_phi.ravel())
            load = needed if load is None else load
        elif load is None:
            load = inverse_dynamics(self.tree, motion.q, motion.v, motion.vd, robot.total_phi)
        seen = robot.motion(motion, sign_width=self.sign_width, load=load)
        of_log = replace(
            seen,
            log=log_number(trajectory.name),
            bandwidth=trajectory.filter.bandwidth,
            acceleration_noise=trajectory.acceleration_noise,
        )
        seen = robot.with_effort(of_log)  # gains scale contacts of this log, and play
        effects = tuple(part for part in parts if isinstance(part, Effect))
        found = dict(zip(effects, EffectColumns(robot.joints, effects).fit_rows(seen), strict=True))
        return [inertial if isinstance(part, str) else found[part] for part in parts], seen.load

    def _inertial_at(self, motion: Motion, phi: Array) -> tuple[dict[int, Array], Array]:
        """Return inertial columns of every joint, and the efforts (N, nv) for φ (10 nb,)."""
        rows = {j: np.empty((len(own), len(motion))).T for j, own in enumerate(self.bodies)}
        load = np.empty(motion.v.shape)
        for part, Y in regressor_pieces(self.tree, motion.q, motion.v, motion.vd):
            np.matmul(Y, phi, out=load[part])
            for j, own in enumerate(self.bodies):  # (checked modes copy)
                np.take(Y[:, j], own, axis=1, out=rows[j][part], mode="clip")
        return rows, load


@dataclass(frozen=True, eq=False)
class LogSlice:
    """Samples of a stretch that are filtered together."""

    layout: Layout  # which columns each joint has
    trajectory: Trajectory
    stretch: Stretch
    samples: slice  # some of the segment's samples
    # (nv,) seconds by which the efforts were logged late, for each column of efforts.
    advance: Sequence[Array]
    place: Hashable

    @property
    def count(self) -> int:
        """How many outputs the filter has of the samples."""
        return self.trajectory.filter.output_count(self.samples.stop - self.samples.start)

    def rows(self, shared: RowCache) -> list[JointRows]:
        """Return filtered rows of every joint; `shared` is used and filled."""
        motion, columns = self._motion_rows(shared), self._columns(shared)
        efforts, carried = self._efforts(shared), self._carried(columns, shared)
        of_joints = [list[Array]() for _ in self.layout.columns]
        for blocks in columns:
            for j, block in blocks.items():
                of_joints[j].append(block)
        return [
            JointRows(
                motion[-1][at],
                motion[j][at, :3],
                _stacked(of_joints[j]),
                efforts[at, j] - carried[j][:, None],
                at,
                carried[j],
            )
            for j, at in enumerate(self._moving(shared))
        ]

    def _moving(self, shared: RowCache) -> list[Indices]:
        """Return the outputs of each joint in which it moves: others have no rows."""
        motion = self._motion_rows(shared)
        joints = range(len(self.layout.columns))
        return [np.flatnonzero(motion[j][:, 3] <= MOSTLY_STILL) for j in joints]

    @cached_property
    def _near(self) -> tuple[Segment, slice]:
        """The samples and their neighbourhood, and their indices in it."""
        late = float(np.abs(self.advance).max(initial=0.0)) / self.stretch.period
        margin = SPLINE_REACH + round(late)
        low = max(0, self.samples.start - margin)
        inner = slice(self.samples.start - low, self.samples.stop - low)
        return self.stretch[low : self.samples.stop + margin], inner

    @cached_property
    def _here(self) -> Segment:
        near, inner = self._near
        return near[inner]

    def contact_rows(self, shared: RowCache) -> MixedRows | None:
        """See `contact_rows.contact_rows`."""
        key = "contact rows", self.place
        if (found := shared.get(key)) is None:
            rows = contact_rows(self.layout.model, self.trajectory, self._here)
            if rows is None:
                return None
            found = {_OWN: rows.own, **rows.mixed}
            shared.keep(key, found)
        return MixedRows(found[_OWN], {i: row for i, row in found.items() if i != _OWN})

    @cached_property
    def _row_ratios(self) -> Array:
        """(nv, nv) noise of the row of the second velocity over that of the first."""
        scales = row_scales(self.layout.model, self.trajectory)
        return scales / scales[:, None]

    @cached_property
    def _effort_spline(self) -> BSpline | None:
        """Spline that interpolates efforts at other instants, if needed."""
        effort = self._near[0].motor_effort
        if len(effort) < 2 or not any(seconds.any() for seconds in self.advance):
            return None
        return spline_through(effort)

    def _motion_rows(self, shared: RowCache) -> Blocks:
        """Return per joint (K, 4) motion and share of time at rest; at −1 the (K,) instants."""

        def make() -> Blocks:
            here, low_pass = self._here, self.trajectory.filter
            at = low_pass.output_indices(len(here))
            states = np.stack([here.position, here.velocity, here.acceleration], 2)[at]
            rests = np.asarray(np.abs(here.velocity) < self.layout.still_speed)
            if (rows := self.contact_rows(shared)) is not None:
                felt = rests | (rows.own == 0.0)
                for j, row in rows.mixed.items():
                    shares = np.abs(row) * self._row_ratios[j]
                    felt[:, j] = ((shares > _FELT) & rests).any(axis=1) | ~row.any(axis=1)
                rests = np.asarray(felt)
            still = low_pass.apply(rests)
            both = np.concatenate([states, still[:, :, None]], 2)
            return {-1: here.time[at], **{j: both[:, j] for j in range(both.shape[1])}}

        return shared.once(("motion", self.place), make)

    def _efforts(self, shared: RowCache) -> Array:
        """Return (K, nv, d) filtered efforts as they were logged `advance` seconds later."""

        def advanced(seconds: Array) -> Blocks:
            (near, inner), period = self._near, self.stretch.period
            moved = delayed_by(-seconds, near.motor_effort, period, spline=self._effort_spline)
            moved = moved[inner]
            if (rows := self.contact_rows(shared)) is not None:
                moved = rows.efforts(moved)
            return {0: self.trajectory.filter.apply(moved)}

        keys = [("effort", seconds.tobytes(), self.place) for seconds in self.advance]
        pairs = zip(keys, self.advance, strict=True)
        return np.stack([shared.once(key, partial(advanced, s))[0] for key, s in pairs], -1)

    def _carried(self, blocks: Sequence[Blocks], shared: RowCache) -> list[Array]:
        """Return per joint (K,) filtered efforts of the log's known payloads.

        It is less by what the columns of bodies have in them of effects that have their own.
        """
        layout = self.layout
        phi = carried_phi(layout.model, self.trajectory.payloads).ravel()
        inertial, others = blocks[layout.parts.index(INERTIA)], layout.blocks_in_bodies(blocks)
        bodies = [
            inertial[j] @ phi[own] - layout.in_bodies(j, others)
            for j, own in enumerate(layout.bodies)
        ]
        if (ground := self._here.ground) is None:
            return bodies
        pushed = self.trajectory.filter.apply(ground)
        return [b - p[at] for b, p, at in zip(bodies, pushed.T, self._moving(shared), strict=True)]

    def _columns(self, shared: RowCache) -> list[Blocks]:
        """Return filtered columns of all parts of the layout."""
        layout, gravity = self.layout, self.layout.tree.gravity.tobytes()
        keys = [(part, self.place, origin) for part, origin in layout.origins]
        found = [shared.get(key) for key in keys]
        places = [k for k, blocks in enumerate(found) if blocks is None]
        if places:
            missing = [layout.parts[k] for k in places]
            gains = gains_of(layout.model)
            key = ("load", self.place, layout.model.total_phi.tobytes(), gains.tobytes(), gravity)
            known = shared.get(key)
            motion, load = self._motion(shared), None if known is None else known[0]
            rows = self.contact_rows(shared)
            if self.trajectory.is_grounded and load is None:
                load = self._load(motion, rows)
            new, load = layout.evaluate(motion, self.trajectory, missing, load)
            shared.keep(key, {0: load}, signals=True)
            for k, blocks in zip(places, self._filtered(missing, new, shared), strict=True):
                found[k] = blocks
                shared.keep(keys[k], blocks)
        return [blocks for blocks in found if blocks is not None]

    def _load(self, motion: Motion, rows: MixedRows | None) -> Array:
        """Return loads (N, nv) of joints without ground forces, which no model predicts.

        They are the efforts of motors, by the gains that the model has; in limbs in the air they
        are what the model needs. Columns that follow measured efforts there would explain the noise
        of these.
        """
        efforts = self._here.motor_effort / gains_of(self.layout.model)
        if rows is None:
            return efforts
        phi = carrying(self.layout.model, self.trajectory.payloads).total_phi
        needed = inverse_dynamics(self.layout.tree, motion.q, motion.v, motion.vd, phi)
        return np.where(rows.own == 1.0, needed, efforts)

    def _filtered(
        self, parts: Sequence[Part], blocks: Sequence[Blocks], shared: RowCache
    ) -> list[dict[int, Array]]:
        """Return filtered columns of some parts in the rows of joints, from those of velocities."""
        moving, found = self._moving(shared), [dict[int, Array]() for _ in parts]
        for row, widths, columns in self._unfiltered(parts, blocks, shared):
            filtered = self.trajectory.filter.apply(columns, moving[row])
            ends = np.cumsum([*widths.values()])[:-1]
            for part, own in zip(widths, np.split(filtered, ends, axis=1), strict=True):
                found[part][row] = own
        return found

    def _unfiltered(
        self, parts: Sequence[Part], blocks: Sequence[Blocks], shared: RowCache
    ) -> Iterator[tuple[int, dict[int, int], Array]]:
        """Yield rows, how many columns each part has there, and these at the full rate (N, ·)."""
        layout, rows = self.layout, self.contact_rows(shared)
        count, nv = self.samples.stop - self.samples.start, len(layout.columns)
        coupling = np.eye(nv, dtype=bool) if layout.coupling is None else layout.coupling
        acts = np.array([[j in each for j in range(nv)] for each in blocks])
        mixed = {} if rows is None else rows.mixed
        together = self._mixed(parts, blocks, coupling[np.array([*mixed], int)].any(axis=0))
        for row, felt in enumerate(coupling):
            widths = {k: layout.width(parts[k], row) for k in np.flatnonzero(acts @ felt).tolist()}
            if not widths:
                continue
            if row not in mixed:
                own = [blocks[k].get(row, np.zeros((count, w))) for k, w in widths.items()]
                columns = _stacked(own)
                if rows is not None and (rows.own[:, row] != 1.0).any():
                    columns *= rows.own[:, row, None]
            else:
                columns = np.zeros((sum(widths.values()), count)).T
                weights = contiguous(mixed[row].T)
                first = np.zeros(len(parts), np.intp)  # columns of parts in these
                first[[*widths]] = np.cumsum([0, *widths.values()])[:-1]
                for of, places, sources, block in together:
                    at = layout.places(parts[int(of[0])], places, row)
                    used = np.flatnonzero(felt[sources] & (at >= 0))
                    which = used, sources[used], first[of[used]] + at[used]
                    add_weighted(weights, block, which, columns.T)
            yield row, widths, columns

    def _mixed(
        self, parts: Sequence[Part], blocks: Sequence[Blocks], felt: NDArray[np.bool_]
    ) -> list[tuple[Indices, Indices, Indices, Array]]:
        """Return columns of velocities that are felt by mixed rows, those of all effects together.

        They are numbers of parts (k,), which of their columns each is, whose it is, and (k, N).
        """
        found, few = (list[tuple[Indices, Indices, Indices, Array]]() for _ in range(2))
        for k, each in enumerate(blocks):
            part = parts[k]
            for j in (j for j in each if felt[j]):
                own = np.arange(each[j].shape[1])
                places = own if isinstance(part, Effect) else self.layout.bodies[j]
                one = np.full_like(own, k), places, np.full_like(own, j), contiguous(each[j].T)
                (few if isinstance(part, Effect) else found).append(one)
        if few:
            numbers, places, sources, columns = map(np.concatenate, zip(*few, strict=True))
            found.append((numbers, places, sources, columns))
        return found

    def _motion(self, shared: RowCache) -> Motion:

        def make() -> Blocks:
            here = self._here
            return dict(enumerate((here.position, here.velocity, here.acceleration, here.time)))

        model = self.layout.model
        found = shared.once(("unfiltered motion", self.place), make, signals=True)
        position, velocity, acceleration, time = (found[i] for i in range(4))
        return Motion(
            model.positions(position),
            velocity,
            acceleration,
            time - self.trajectory.began,
            model.positions(self._past()),
            self.trajectory.temperature(time),
        )

    def _past(self) -> Array:
        """Return (M, nv) positions before the slice, as far as an effect needs them."""
        start = self.samples.start
        if start == 0 or not any(effect.state_count for effect in self.layout.effects):
            return np.zeros((0, len(self.layout.model.joints)))
        return self.stretch[max(0, start - MEMORY) : start].position


def _stacked(blocks: Iterable[Array]) -> Array:
    """Return columns (K, ·) side by side, each of them as one piece of memory."""
    return np.concatenate([block.T for block in blocks]).T


def gains_of(model: RobotModel) -> Array:
    """Return (nv,) logged efforts over those of joints, by the gains that a model has."""
    gains = np.ones(len(model.joints))
    for fitted in model.effects:
        if fitted.effect.role is Role.SCALE:
            gains[model.joints.index(fitted.effect.where[0])] += fitted.parameters[0]
    return gains


def _probe(model: RobotModel, samples: int) -> Motion:
    """Return random motion, to see which columns can be nonzero."""
    random, nv = np.random.default_rng(0), len(model.joints)
    q = model.tree.inside(model.positions(random.normal(size=(samples, nv))))
    return Motion(q, random.normal(size=(samples, nv)), random.normal(size=(samples, nv)))


def _felt(model: RobotModel, effects: Sequence[Effect]) -> tuple[KinematicTree, Effect | None]:
    """Return the tree with the gravity on its bodies, and the effect that changes it.

    Where columns are exact about two places, they are so about the latter.
    """
    for effect in reversed(effects):
        gravity = effect.gravity_of_bodies(model.tree.gravity)
        if gravity is not None:
            return replace(model.tree, gravity=gravity), effect
    return model.tree, None
