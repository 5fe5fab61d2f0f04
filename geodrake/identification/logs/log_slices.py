"""Filtered rows of every joint in slices of logs, cached across reductions of the same logs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import contiguous
from geodrake.effects.base import Effect
from geodrake.effects.declarations import Role
from geodrake.effects.effect_columns import EffectColumns, declares_signals
from geodrake.effects.robot_motion import log_number
from geodrake.identification.logs.contact_rows import (
    MixedRows,
    add_weighted,
    contact_rows,
    row_scales,
)
from geodrake.identification.logs.dataset import Indices, JointRows, column_starts, is_payload
from geodrake.logs.filtering import SPLINE_REACH, shifted, spline_coefficients
from geodrake.logs.motion import MEMORY, Motion, Trajectory
from geodrake.logs.smoothing import Segment, Stretch
from geodrake.model.carried_payloads import carried_phi, carrying
from geodrake.model.robot_model import RobotModel
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.regressor import inverse_dynamics, inverse_dynamics_regressor, regressor_pieces

Array = NDArray[np.float64]
Part = Effect | str
"""Owner of columns: an effect or `INERTIA`."""

Blocks = Mapping[int, Array]
"""Columns (K, k) by joint index."""

ROOM = 10_000_000
"""Size of the cache of reductions, in numbers (80 MB)."""

MIXED_ROOM = 30_000_000
"""The same with unknown contact forces, where rows of the base depend on all joints."""

SIGNALS_ROOM = 2_000_000
"""The part for signals at the logs' full rate; filtered columns are more expensive to recompute."""


class RowCache:
    """Cache shared by reductions of the same logs and robot.

    The columns of an effect do not depend on other candidates, so that a reduction evaluates only
    new ones. When the cache is full, the least recently used entries are evicted, except those of
    this reduction and the last. `signals` at the full rate, which only new columns need, never
    evict others.
    """

    def __init__(self, room: int = ROOM, *, signals: int = SIGNALS_ROOM) -> None:
        self._room, self._signals, self._kept = room, signals, dict[Hashable, Blocks]()
        self._used, self._turn, self._stale = dict[Hashable, int](), 0, list[Hashable]()

    def begin(self) -> None:
        """Start another reduction."""
        self._turn += 1
        self._stale = sorted(self._used, key=self._used.__getitem__, reverse=True)

    def get(self, key: Hashable) -> Blocks | None:
        """Return the cached value of a key, or None."""
        if key in self._used:
            self._used[key] = self._turn
        return self._kept.get(key)

    def once(self, key: Hashable, make: Callable[[], Blocks], *, signals: bool = False) -> Blocks:
        """Return the cached value of a key, or compute and cache it; see `keep`."""
        if (found := self.get(key)) is None:
            self.keep(key, found := make(), signals=signals)
        return found

    def read_only(self) -> RowCache:
        """Return a view of the cache for reductions whose columns are not needed again."""
        reader = RowCache(0)
        reader._kept = self._kept
        return reader

    def keep(self, key: Hashable, blocks: Blocks, *, signals: bool = False) -> None:
        """Cache blocks if there is room; `signals` are at the full rate."""
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

_SINGLE = -1  # key of `MixedRows.single` in the cache
_FELT = 0.02  # part in a row, relative to its noise, from which a joint at rest invalidates the row

_OTHERS = frozenset({"load", "bodies"})
"""Signals that depend on more than the motion."""

MOSTLY_STILL = 0.3
"""Largest share of the filter's window in which a joint may be at rest, for a sample to be used.

At rest, dry friction can have any value up to breakaway.
"""


@dataclass(frozen=True, eq=False)
class Layout:
    """Columns of each joint, and their evaluation."""

    model: RobotModel
    effects: tuple[Effect, ...]  # effects with columns
    sign_width: Array  # (nv,) speed below which the direction of motion is unknown
    still_speed: Array  # (nv,) speed below which a joint is at rest
    columns: tuple[Indices, ...]  # per joint, the global indices of its columns
    # (nv, nv) whether a row includes a joint, if unknown contact forces are eliminated.
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
        shared: RowCache | None = None,
    ) -> Layout:
        """Return the layout of the columns of bodies and effects.

        With a `coupling` (nv, nv), a row has the columns of all joints that it includes. `shared`
        is the cache of reductions.
        """
        motion = _probe(model, 7)
        size = np.abs(
            inverse_dynamics_regressor(
                _tree_and_tilt(model, effects)[0], motion.q, motion.v, motion.vd
            )
        ).max(axis=0)
        inertial = size > 1e-12 * size.max(initial=1e-300)
        starts = column_starts(effects, model.bodies)
        if coupling is not None:
            inertial = coupling @ inertial
        columns = [[np.flatnonzero(inertial[j])] for j in range(len(model.joints))]
        probe, shared = model.motion(_probe(model, 1), sign_width=1.0), shared or RowCache(0)

        def probed(effect: Effect) -> Blocks:
            return EffectColumns(model.joints, (effect,)).fit_rows(probe)[0]

        for effect in effects:
            if is_payload(effect):
                continue
            blocks = shared.once(("probe", effect), partial(probed, effect))
            indices = starts[effect] + np.arange(len(effect.parameters))
            felt = blocks if coupling is None else np.flatnonzero(coupling[:, [*blocks]].any(1))
            for joint in felt:
                columns[joint].append(indices)
        joined = tuple(np.concatenate(c) for c in columns)
        return cls(model, effects, sign_width, still_speed, joined, coupling=coupling)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Owners of columns, in order."""
        return (INERTIA, *(effect for effect in self.effects if not is_payload(effect)))

    def places(self, part: Part, columns: Indices, row: int) -> Indices:
        """Return the indices of a part's columns among those in a row; −1 where absent."""
        if isinstance(part, Effect):
            return columns
        inertial = self.bodies[row]
        return np.where(np.isin(columns, inertial), np.searchsorted(inertial, columns), -1)

    def width(self, part: Part, row: int) -> int:
        """Return the number of columns of a part in a row."""
        return len(part.parameters) if isinstance(part, Effect) else len(self.bodies[row])

    @cached_property
    def bodies(self) -> list[Indices]:
        """Indices of the inertial columns of each joint."""
        return [c[c < self.model.phi.size] for c in self.columns]

    @property
    def tree(self) -> KinematicTree:
        """The tree for the columns of bodies, with the gravity that acts on them."""
        return self._tree_and_tilt[0]

    @cached_property
    def _tree_and_tilt(self) -> tuple[KinematicTree, Effect | None]:
        return _tree_and_tilt(self.model, self.effects)

    def in_bodies(self, joint: int, blocks: Mapping[Effect, Blocks]) -> Array | float:
        """Return the effort (K,) of effects included in a joint's columns of bodies, or 0."""
        effect = self._tree_and_tilt[1]
        if effect is None or joint not in blocks[effect]:
            return 0.0
        return np.asarray(blocks[effect][joint] @ effect.in_bodies)

    def blocks_in_bodies(self, blocks: Sequence[Blocks]) -> dict[Effect, Blocks]:
        """Return the columns that `in_bodies` needs, from those of all parts."""
        effect = self._tree_and_tilt[1]
        return {} if effect is None else {effect: blocks[self.parts.index(effect)]}

    @cached_property
    def origins(self) -> list[tuple[Part, Hashable]]:
        """Each part with a key of its columns' dependencies other than the motion."""
        widths, origins = self.sign_width.tobytes(), list[tuple[Part, Hashable]]()
        for part in self.parts:
            if isinstance(part, Effect):
                of_motion = declares_signals(type(part)) and not part.depends_on & _OTHERS
                origins.append((part, widths if of_motion else self._origin))
            else:
                origins.append((part, self.tree.gravity.tobytes()))
        return origins

    @cached_property
    def _origin(self) -> Hashable:
        """Key of the model's efforts and sign widths."""
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

        The load is the effort of the bodies with payloads, unless it is given.
        """
        robot, inertial = carrying(self.model, trajectory.payloads), dict[int, Array]()
        if INERTIA in parts:
            inertial, of_bodies = self._inertial_at(motion, robot.total_phi.ravel())
            load = of_bodies if load is None else load
        elif load is None:
            load = inverse_dynamics(self.tree, motion.q, motion.v, motion.vd, robot.total_phi)
        of_log = replace(
            robot.motion(motion, sign_width=self.sign_width, load=load),
            log=log_number(trajectory.name),
            bandwidth=trajectory.filter.bandwidth,
            acceleration_noise=trajectory.acceleration_noise,
        )
        state = robot.with_effort(of_log)  # gains scale this log's contacts and backlash
        effects = tuple(part for part in parts if isinstance(part, Effect))
        rows = EffectColumns(robot.joints, effects).fit_rows(state)
        columns = dict(zip(effects, rows, strict=True))
        return [inertial if isinstance(part, str) else columns[part] for part in parts], state.load

    def _inertial_at(self, motion: Motion, phi: Array) -> tuple[dict[int, Array], Array]:
        """Return inertial columns of every joint, and the efforts (N, nv) for φ (10 nb,)."""
        rows = [np.empty((len(at), len(motion))) for at in self.bodies]
        load = np.empty(motion.v.shape)
        for part, Y in regressor_pieces(self.tree, motion.q, motion.v, motion.vd):
            np.matmul(Y, phi, out=load[part])
            for j, at in enumerate(self.bodies):
                rows[j][:, part] = Y[:, j].T[at]
        return {j: columns.T for j, columns in enumerate(rows)}, load


@dataclass(frozen=True, eq=False)
class LogSlice:
    """Samples of a stretch that are filtered together."""

    layout: Layout
    trajectory: Trajectory
    stretch: Stretch
    samples: slice  # of the stretch
    # For each column of efforts, the delays (nv,) of the logged efforts, s.
    advance: Sequence[Array]
    place: Hashable

    @property
    def count(self) -> int:
        """Number of outputs of the filter."""
        return self.trajectory.filter.output_count(self.samples.stop - self.samples.start)

    def rows(self, shared: RowCache) -> list[JointRows]:
        """Return filtered rows of every joint, using and filling the cache."""
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
                _stacked([*of_joints[j], efforts[at, j] - carried[j][:, None]]),
                len(self.advance),
                at,
                carried[j],
            )
            for j, at in enumerate(self._moving(shared))
        ]

    def _moving(self, shared: RowCache) -> list[Indices]:
        """Return the outputs of each joint in which it moves; others have no rows."""
        motion = self._motion_rows(shared)
        joints = range(len(self.layout.columns))
        return [np.flatnonzero(motion[j][:, 3] <= MOSTLY_STILL) for j in joints]

    @cached_property
    def _near(self) -> tuple[Segment, slice]:
        """The samples with a margin, and their indices in it."""
        longest = float(np.abs(self.advance).max(initial=0.0)) / self.stretch.period
        margin = SPLINE_REACH + round(longest)
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
        if (cached := shared.get(key)) is None:
            rows = contact_rows(self.layout.model, self.trajectory, self._here)
            if rows is None:
                return None
            cached = {_SINGLE: rows.single, **rows.mixed}
            shared.keep(key, cached)
        return MixedRows(cached[_SINGLE], {i: row for i, row in cached.items() if i != _SINGLE})

    @cached_property
    def _row_ratios(self) -> Array:
        """(nv, nv) noise of the second velocity's row relative to the first's."""
        scales = row_scales(self.layout.model, self.trajectory)
        return scales / scales[:, None]

    @cached_property
    def _effort_spline(self) -> tuple[Array, int]:
        """Coefficients (·, nv) of splines through efforts, and the index of the first sample.

        Efforts before and after a piece are its first and last ones.
        """
        near, inner = self._near
        beyond = 3 + int(np.abs(self.advance).max(initial=0.0) / self.stretch.period + 1.0)
        padded = np.pad(near.motor_effort, ((beyond, beyond), (0, 0)), mode="edge")
        return spline_coefficients(padded), beyond + inner.start

    @cached_property
    def _smooth_spline(self) -> Array:
        return self.trajectory.filter.smooth(self._effort_spline[0])

    def _motion_rows(self, shared: RowCache) -> Blocks:
        """Return the motion and share of time at rest (K, 4) by joint, and instants (K,) at −1."""

        def make() -> Blocks:
            here, low_pass = self._here, self.trajectory.filter
            outputs = low_pass.output_indices(len(here))
            states = np.stack([here.position, here.velocity, here.acceleration], 2)[outputs]
            rests = np.asarray(np.abs(here.velocity) < self.layout.still_speed)
            if (rows := self.contact_rows(shared)) is not None:
                invalid = rests | (rows.single == 0.0)
                for j, row in rows.mixed.items():
                    shares = np.abs(row) * self._row_ratios[j]
                    invalid[:, j] = ((shares > _FELT) & rests).any(axis=1) | ~row.any(axis=1)
                rests = np.asarray(invalid)
            still = low_pass.apply(rests)
            joined = np.concatenate([states, still[:, :, None]], 2)
            return {-1: here.time[outputs], **{j: joined[:, j] for j in range(joined.shape[1])}}

        return shared.once(("motion", self.place), make)

    def _efforts(self, shared: RowCache) -> Array:
        """Return filtered efforts (K, nv, d), each advanced by its delay."""

        def advanced(seconds: Array) -> Blocks:
            low_pass, steps = self.trajectory.filter, seconds / self.stretch.period
            coefficients, first = self._effort_spline
            samples = np.arange(self.samples.stop - self.samples.start)
            if (rows := self.contact_rows(shared)) is None:  # shifts and filters commute
                at = first + low_pass.output_indices(len(samples))
                return {0: shifted(self._smooth_spline, at, steps)}
            return {0: low_pass.apply(rows.efforts(shifted(coefficients, first + samples, steps)))}

        keys = [("effort", seconds.tobytes(), self.place) for seconds in self.advance]
        pairs = zip(keys, self.advance, strict=True)
        return np.stack([shared.once(key, partial(advanced, s))[0] for key, s in pairs], -1)

    def _carried(self, blocks: Sequence[Blocks], shared: RowCache) -> list[Array]:
        """Return `JointRows.carried` (K,) of every joint."""
        layout = self.layout
        phi = carried_phi(layout.model, self.trajectory.payloads).ravel()
        inertial, others = blocks[layout.parts.index(INERTIA)], layout.blocks_in_bodies(blocks)
        bodies = [
            inertial[j] @ phi[at] - layout.in_bodies(j, others)
            for j, at in enumerate(layout.bodies)
        ]
        if (ground := self._here.ground) is None:
            return bodies
        wrench = self.trajectory.filter.apply(ground)
        return [b - w[at] for b, w, at in zip(bodies, wrench.T, self._moving(shared), strict=True)]

    def _columns(self, shared: RowCache) -> list[Blocks]:
        """Return filtered columns of all parts of the layout."""
        layout, gravity = self.layout, self.layout.tree.gravity.tobytes()
        keys = [(part, self.place, origin) for part, origin in layout.origins]
        blocks_of_parts = [shared.get(key) for key in keys]
        places = [k for k, blocks in enumerate(blocks_of_parts) if blocks is None]
        if places:
            missing = [layout.parts[k] for k in places]
            gains = gains_of(layout.model)
            key = ("load", self.place, layout.model.total_phi.tobytes(), gains.tobytes(), gravity)
            cached = shared.get(key)
            motion, load = self._motion(shared), None if cached is None else cached[0]
            rows = self.contact_rows(shared)
            if self.trajectory.is_grounded and load is None:
                load = self._load(motion, rows)
            new, load = layout.evaluate(motion, self.trajectory, missing, load)
            shared.keep(key, {0: load}, signals=True)
            for k, blocks in zip(places, self._filtered(missing, new, shared), strict=True):
                blocks_of_parts[k] = blocks
                shared.keep(keys[k], blocks)
        return [blocks for blocks in blocks_of_parts if blocks is not None]

    def _load(self, motion: Motion, rows: MixedRows | None) -> Array:
        """Return the loads (N, nv) of joints under unpredictable ground forces.

        They are the measured efforts of motors, with the model's gains. In limbs in the air they
        are the model's efforts, as columns of measured efforts would fit the noise of these.
        """
        efforts = self._here.motor_effort / gains_of(self.layout.model)
        if rows is None:
            return efforts
        phi = carrying(self.layout.model, self.trajectory.payloads).total_phi
        predicted = inverse_dynamics(self.layout.tree, motion.q, motion.v, motion.vd, phi)
        return np.where(rows.single == 1.0, predicted, efforts)

    def _filtered(
        self, parts: Sequence[Part], blocks: Sequence[Blocks], shared: RowCache
    ) -> list[dict[int, Array]]:
        """Return filtered columns of some parts in the joints' rows, from unfiltered columns."""
        moving, of_parts = self._moving(shared), [dict[int, Array]() for _ in parts]
        for row, widths, columns in self._unfiltered(parts, blocks, shared):
            filtered = self.trajectory.filter.apply(columns, moving[row])
            ends = np.cumsum([*widths.values()])[:-1]
            for part, block in zip(widths, np.split(filtered, ends, axis=1), strict=True):
                of_parts[part][row] = block
        return of_parts

    def _unfiltered(
        self, parts: Sequence[Part], blocks: Sequence[Blocks], shared: RowCache
    ) -> Iterator[tuple[int, dict[int, int], Array]]:
        """Yield rows, the number of columns of each part there, and unfiltered columns (N, ·)."""
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
                parts_here = [blocks[k].get(row, np.zeros((count, w))) for k, w in widths.items()]
                columns = _stacked(parts_here)
                if rows is not None and (rows.single[:, row] != 1.0).any():
                    columns *= rows.single[:, row, None]
            else:
                columns = np.zeros((sum(widths.values()), count)).T
                weights = contiguous(mixed[row].T)
                first = np.zeros(len(parts), np.intp)  # first column of each part
                first[[*widths]] = np.cumsum([0, *widths.values()])[:-1]
                for owners, places, sources, block in together:
                    at = layout.places(parts[int(owners[0])], places, row)
                    used = np.flatnonzero(felt[sources] & (at >= 0))
                    which = used, sources[used], first[owners[used]] + at[used]
                    add_weighted(weights, block, which, columns.T)
            yield row, widths, columns

    def _mixed(
        self, parts: Sequence[Part], blocks: Sequence[Blocks], felt: NDArray[np.bool_]
    ) -> list[tuple[Indices, Indices, Indices, Array]]:
        """Return the columns of velocities that affect mixed rows, joined for all effects.

        Each entry has part indices (k,), column indices in these parts, velocities, and the columns
        (k, N).
        """
        joined, of_effects = (list[tuple[Indices, Indices, Indices, Array]]() for _ in range(2))
        for k, block in enumerate(blocks):
            part = parts[k]
            for j in (j for j in block if felt[j]):
                order = np.arange(block[j].shape[1])
                places = order if isinstance(part, Effect) else self.layout.bodies[j]
                columns = contiguous(block[j].T)
                entry = np.full_like(order, k), places, np.full_like(order, j), columns
                (of_effects if isinstance(part, Effect) else joined).append(entry)
        if of_effects:
            owners, places, sources, columns = map(np.concatenate, zip(*of_effects, strict=True))
            joined.append((owners, places, sources, columns))
        return joined

    def _motion(self, shared: RowCache) -> Motion:

        def make() -> Blocks:
            here = self._here
            return dict(enumerate((here.position, here.velocity, here.acceleration, here.time)))

        model = self.layout.model
        signals = shared.once(("unfiltered motion", self.place), make, signals=True)
        position, velocity, acceleration, time = (signals[i] for i in range(4))
        return Motion(
            model.positions(position),
            velocity,
            acceleration,
            time - self.trajectory.began,
            model.positions(self._past()),
            self.trajectory.temperature(time),
        )

    def _past(self) -> Array:
        """Return positions (M, nv) before the slice, for effects with a state."""
        start = self.samples.start
        if start == 0 or not any(effect.state_count for effect in self.layout.effects):
            return np.zeros((0, len(self.layout.model.joints)))
        return self.stretch[max(0, start - MEMORY) : start].position


def _stacked(blocks: Iterable[Array]) -> Array:
    """Return the blocks' columns (K, ·) side by side, in Fortran order."""
    return np.concatenate([block.T for block in blocks]).T


def gains_of(model: RobotModel) -> Array:
    """Return the model's gains (nv,) of logged efforts."""
    gains = np.ones(len(model.joints))
    for fitted in model.effects:
        if fitted.effect.role is Role.SCALE:
            gains[model.joints.index(fitted.effect.where[0])] += fitted.parameters[0]
    return gains


def _probe(model: RobotModel, samples: int) -> Motion:
    """Return random motion, to detect nonzero columns."""
    random, nv = np.random.default_rng(0), len(model.joints)
    q = model.tree.inside(model.positions(random.normal(size=(samples, nv))))
    return Motion(q, random.normal(size=(samples, nv)), random.normal(size=(samples, nv)))


def _tree_and_tilt(
    model: RobotModel, effects: Sequence[Effect]
) -> tuple[KinematicTree, Effect | None]:
    """Return the tree with the gravity on its bodies, and the last effect that changes it."""
    for effect in reversed(effects):
        gravity = effect.gravity_of_bodies(model.tree.gravity)
        if gravity is not None:
            return replace(model.tree, gravity=gravity), effect
    return model.tree, None
