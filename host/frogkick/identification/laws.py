"""Laws that the catalogue does not have: formulas of a grammar, screened by linear responses (``responses``).

A formula's values along the run are multiplied by the responses. The best one of each kind joins the
candidates; see host/docs/pages/explanation/identification.md.

Source: Mojgani, Chattopadhyay, Hassanzadeh 2022 (model error as a sparse law of what a filter had to add);
Brunton, Proctor, Kutz 2016 (regression on a library of terms).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from frogkick.core.arrays import Float64, Int64
from frogkick.core.progress import TellStage, silent
from frogkick.effects.limbs import ALL
from frogkick.identification.fit import PARAMETER_PENALTY, Fitted, Model, deviances_of, evaluate, step_bounds
from frogkick.identification.law_kinds import MOMENTS, Kind, kinds_of
from frogkick.identification.responses import Responses
from frogkick.identification.screening import Column
from frogkick.identification.segments import Data, Segments
from frogkick.identification.steps import DOF, linearised_optimum, whitener
from frogkick.identification.terms import Term
from frogkick.robot import Robot

REFINED = 8  # kinds whose shapes are refined beyond the grid, best first
TRIED = 4  # shapes of each kind whose gain is computed exactly; they are chosen by one least-squares step

BIN_S, BINS_MOST = 0.2, 400
"""A law at intervals is screened as a sum of bins of this length, longer if there would be more than
BINS_MOST."""

SMALL, LARGE = 1e-3, 0.6
"""Steps of the finite differences by which strengths are screened, as shares of their range. A loss of a
limb's gain is screened at a large step as well, because a weak limb pushes in another direction."""

BY_CHANCE = 24
"""Shapes of each kind that enter the estimate of the largest gain by chance: their neighbours act alike."""

MOMENT = "at"  # name of the parameter that is a law's moment
WORSE = 3.84  # rise of the deviance at the ends of a 95 % interval (chi-square with one degree of freedom)
SAME = 0.04  # two moments fit equally well if their deviances differ by less
NEIGHBOURS = 6  # gaps between strokes that are tried on each side of the moment's own gap


class Laws:
    """The grammar of laws for some runs, with the responses of the runs to each law."""

    def __init__(
        self, responses: Responses, swims: Sequence[Segments], robot: Robot, progress: TellStage = silent
    ) -> None:
        """Evaluate every kind of law at every shape of its grid."""
        self._responses, self._limbs = responses, [limb.name for limb in robot.limbs]
        # kind, size of the step, indices of the shapes of its grid that act, and their (k, n, 9, p) columns
        self._grids: list[tuple[Kind, float | None, list[int], Float64]] = []
        # kind that acts at intervals, (k, b) bins in which each shape acts, and their (b, n, 9, p) columns
        self._bins: list[tuple[Kind, Float64, Float64]] = []
        end_s = float(max(swim.end_s[-1] for swim in swims if len(swim.end_s)))
        bin_s = max(BIN_S, end_s / BINS_MOST)
        strokes = np.unique(np.round([at for swim in swims for at, _ in swim.strokes], 1))
        between = 0.5 * (strokes[1:] + strokes[:-1])
        self._between_strokes = between[:: -(-len(between) // MOMENTS) or 1].tolist()
        middles = np.arange(0.5 * bin_s, end_s, bin_s)
        alone = {"cycle": 10.0 * end_s, "share": 0.1 * bin_s / end_s}
        kinds = kinds_of(robot, swims)
        for done, kind in enumerate(kinds):
            progress("laws", done, len(kinds))
            if "middle" in kind.shapes:  # of an interval in each cycle
                bins = [self.columns(kind, {**alone, "middle": float(middle)}) for middle in middles]
                self._bins.append((kind, _on(kind.grid, middles), np.stack(bins)))
                continue
            for size in (None, LARGE) if "loss" in kind.strengths else (None,):
                every = [self.columns(kind, shape, size) for shape in kind.grid]
                kept = [k for k, columns in enumerate(every) if columns.any()]
                if kept:
                    self._grids.append((kind, size, kept, np.stack([every[k] for k in kept])))

    @property
    def every(self) -> list[Float64]:
        """(n, 9, p) derivatives by the screened laws, to estimate the largest gain by chance."""

        def some(count: int) -> Int64:
            return np.unique(np.linspace(0, count - 1, BY_CHANCE).round().astype(np.int64))

        found = [columns[k] for *_, columns in self._grids for k in some(len(columns))]
        for _, on, bins in self._bins:
            found += [np.tensordot(on[k], bins, axes=1) for k in some(len(on))]
        return found

    def columns(self, kind: Kind, shape: Mapping[str, float], size: float | None = None) -> Float64:
        """(n, 9, p) derivatives of the residuals by each strength of a law at a shape, from the responses.

        With a size, the change by a strength of that size divided by the size.
        """
        found = []
        for name, (_, _, high, _) in kind.strengths.items():
            unit = size or SMALL * min(1.0, high)
            given = {**dict.fromkeys(kind.strengths, 0.0), **shape, name: unit}
            found.append(self._responses.to(kind.law, given, self._limbs) / unit)
        return np.stack(found, axis=2)

    def best(self, current: Fitted, title: str | None = None) -> list[Column]:
        """The best law of each kind beside a model, best first; with a title, only that kind."""
        whole = _Beside(current)
        best: list[tuple[float, Kind, Mapping[str, float], float | None]] = []
        for kind, size, kept, columns in self._grids:
            if title not in (None, kind.named):
                continue
            likely = np.argsort(-whole.quick(columns), kind="stable")[:TRIED]
            gain, number = max((whole.gain(kind, columns[k]), kept[k]) for k in likely.tolist())
            row = gain - _penalty(kind), kind, kind.grid[number], size
            if best and best[-1][1] is kind:  # at another size
                best[-1] = max(best[-1], row, key=lambda each: each[0])
            else:
                best.append(row)
        for kind, on, bins in self._bins:
            if title not in (None, kind.named):
                continue
            likely = np.argsort(-whole.quick_sums(on, bins), kind="stable")[:TRIED]
            tried = [(self.columns(kind, kind.grid[k]), k) for k in likely.tolist()]
            gain, number = max((whole.gain(kind, columns), k) for columns, k in tried)
            best.append((gain - _penalty(kind), kind, kind.grid[number], None))
        best.sort(key=lambda row: -row[0])
        for rank, (_, kind, shape, size) in enumerate(best[:REFINED]):
            if kind.shapes:
                shape = self._refined(kind, shape, whole, size)
                gain = whole.gain(kind, self.columns(kind, shape, size))
                best[rank] = gain - _penalty(kind), kind, shape, size
        best.sort(key=lambda row: -row[0])
        found = []
        for _, kind, shape, size in best:
            unknown = np.zeros((*current.residuals.shape, len(kind.shapes)))
            columns = self.columns(kind, shape, size)
            found.append(Column(kind.term(shape), np.concatenate([columns, unknown], axis=2)))
        return found

    def moments(self, title: str) -> list[float]:
        """Moments (s) from which a law could begin to act, one between two strokes; none for other laws.

        If strokes of several runs do not coincide there are more than MOMENTS; then every n-th one is tried.
        """
        low = [
            kind.shapes["at"][1] for kind, *_ in self._grids if kind.named == title and "at" in kind.shapes
        ]
        return [at for at in self._between_strokes if at > low[0]] if low else []

    def _refined(
        self, kind: Kind, shape: Mapping[str, float], whole: _Beside, size: float | None
    ) -> Mapping[str, float]:
        """The best shape near the best one of a grid, within its bounds (Nelder, Mead 1965)."""
        from scipy import optimize

        names = [name for name, (_, _, _, step) in kind.shapes.items() if step]
        if not names:
            return shape
        low, high = (np.array([kind.shapes[name][k] for name in names]) for k in (1, 2))
        start = np.array([shape[name] for name in names])
        # The search reaches to the neighbours on the grid; beyond, another shape of the grid is better.
        near = np.stack([[each[name] for name in names] for each in kind.grid])
        spread = np.array(
            [
                np.diff(np.unique(column)).min(initial=0.1 * reach)
                for column, reach in zip(near.T, high - low, strict=True)
            ]
        )
        simplex = np.vstack([start, *(start + 0.5 * np.diag(np.minimum(spread, 0.2 * (high - low))))])

        def at(values: Float64) -> dict[str, float]:
            return {**shape, **dict(zip(names, np.clip(values, low, high).tolist(), strict=True))}

        found = optimize.minimize(
            lambda values: -whole.gain(kind, self.columns(kind, at(values), size)),
            start,
            method="Nelder-Mead",
            options={
                "initial_simplex": np.clip(simplex, low, high), "maxfev": 40 * len(names), "xatol": 1e-4,
            },
        )  # fmt: skip
        return at(found.x)


def _on(grid: Sequence[Mapping[str, float]], at_s: Float64) -> Float64:
    """(k, b) 1 if a law at intervals acts at a time, else 0."""
    cycle, middle, share = (
        np.array([[each[name]] for each in grid]) for name in ("cycle", "middle", "share")
    )
    return np.asarray(np.cos(2.0 * np.pi * (at_s - middle) / cycle) > np.cos(np.pi * share), np.float64)


def _penalty(kind: Kind) -> float:
    return PARAMETER_PENALTY * (len(kind.strengths) + len(kind.shapes))


class _Beside:
    """Gains of laws beside a model whose parameters stay free."""

    def __init__(self, current: Fitted) -> None:
        self._current, self._bounds = current, step_bounds(current.model)
        self._plain = linearised_optimum(
            current.residuals, current.jacobian, *self._bounds, self._damping(np.empty(0))
        )[1]
        self._white = whitener(current.residuals)
        rows = current.residuals @ self._white
        width = rows.shape[1]
        robust = np.sqrt((DOF + width) / (DOF + (rows**2).sum(axis=1)))
        self._weighed = []
        # Robust weights and equal ones: a law that acts in few periods looks like outliers at first.
        for weight in (robust, np.ones(len(rows))):
            own = np.einsum("nip,ij->njp", current.jacobian, self._white) * weight[:, None, None]
            basis = np.linalg.qr(own.reshape(rows.size, -1))[0]
            left = (rows * weight[:, None]).ravel()
            self._weighed.append((weight, basis, left - basis @ (basis.T @ left)))

    def _damping(self, reach: Float64) -> Float64:
        known = np.full(self._current.jacobian.shape[2], 1e-12)
        return np.append(known, 1e-6 * self._current.residuals.size / np.maximum(reach, 1e-12) ** 2)

    def gain(self, kind: Kind, columns: Float64) -> float:
        """The fall of the deviance by the best strengths of a law, with the model's parameters refitted."""
        low, high = (np.array([given[k] for given in kind.strengths.values()]) for k in (1, 2))
        down, up = self._bounds
        both = np.concatenate([self._current.jacobian, columns], axis=2)
        lows, highs = np.append(down, low), np.append(up, high)
        found = linearised_optimum(self._current.residuals, both, lows, highs, self._damping(high - low))
        return self._plain - found[1]

    def quick(self, columns: Float64) -> Float64:
        """(k,) falls of the sum of squares for (k, n, 9, p) derivatives, to rank shapes of one kind."""
        found = np.zeros(len(columns))
        white = np.einsum("knip,ij->knjp", columns, self._white)
        for weight, basis, left in self._weighed:
            flat = (white * weight[None, :, None, None]).reshape(len(columns), -1, columns.shape[3])
            flat = flat - np.einsum("iq,kqp->kip", basis, np.einsum("iq,kip->kqp", basis, flat))
            normal, slope = np.einsum("kip,kiq->kpq", flat, flat), np.einsum("kip,i->kp", flat, left)
            found = np.maximum(found, _fall(normal, slope) / max(float(left @ left), 1e-30))
        return found

    def quick_sums(self, on: Float64, bins: Float64) -> Float64:
        """(k,) the same for sums of (b, n, 9, p) derivatives over the bins with a 1 in (k, b)."""
        found = np.zeros(len(on))
        white = np.einsum("bnip,ij->bpnj", bins, self._white)
        count, width = white.shape[:2]
        for weight, basis, left in self._weighed:
            flat = (white * weight[None, None, :, None]).reshape(count * width, -1)
            flat = flat - (flat @ basis) @ basis.T
            normal = (flat @ flat.T).reshape(count, width, count, width)
            slope = on @ (flat @ left).reshape(count, width)
            whole = np.empty((len(on), width, width))
            for p in range(width):
                for q in range(width):
                    whole[:, p, q] = ((on @ normal[:, p, :, q]) * on).sum(axis=1)
            found = np.maximum(found, _fall(whole, slope) / max(float(left @ left), 1e-30))
        return found


def _fall(normal: Float64, slope: Float64) -> Float64:
    """(k,) falls of the sum of squares, by (k, p, p) normal matrices and (k, p) slopes."""
    size = np.trace(normal, axis1=1, axis2=2)[:, None, None]
    normal += (1e-9 * size + 1e-30) * np.eye(slope.shape[1])
    return np.asarray(np.einsum("kp,kp->k", slope, np.linalg.solve(normal, slope[:, :, None])[:, :, 0]))


def centred(fitted: Fitted, data: Data) -> Fitted:
    """Move each moment (s) from which a law on strokes acts to the middle of those that fit equally well.

    All moments between two strokes do, so a moment has no derivative. These moments reach from one stroke to
    the next, and farther if the period of a stroke is not used.
    """
    model = fitted.model
    for place, term in enumerate(model.terms):
        borders = _borders(term, fitted.model, data.swims)
        if borders is not None:
            low, high = _alike(fitted, place, borders, data, SAME)
            model = _with_moment(model, place, 0.5 * (low + high))
    if model is fitted.model:
        return fitted
    (moved,) = evaluate([model], [fitted.jacobian], data)
    # If it is worse, its strokes on the fixes' clock are not those of the simulation.
    return fitted if moved.deviance > fitted.deviance + SAME else moved


def moment_intervals(fitted: Fitted, data: Data) -> dict[int, tuple[float, float]]:
    """Likelihood interval (s) of each such moment; the key is the index of the law among the model's terms.

    It extends from stroke to stroke while the deviance, simulated with all other parameters unchanged, rises
    by less than WORSE."""
    borders = [_borders(term, fitted.model, data.swims) for term in fitted.model.terms]
    return {
        place: _alike(fitted, place, those, data, WORSE)
        for place, those in enumerate(borders)
        if those is not None
    }


def _alike(fitted: Fitted, place: int, borders: Float64, data: Data, worse: float) -> tuple[float, float]:
    """Ends (s) of the moments around a law's own at which the deviance is higher by less than ``worse``."""
    term = fitted.model.terms[place]
    at = term.values[_number(term) or 0]
    k = int(np.clip(np.searchsorted(borders, at) - 1, 0, len(borders) - 2))
    tried = np.arange(max(k - NEIGHBOURS, 0), min(k + NEIGHBOURS + 1, len(borders) - 1))
    models = [_with_moment(fitted.model, place, float(borders[each : each + 2].mean())) for each in tried]
    good = set(tried[np.array(deviances_of(models, data)) < fitted.deviance + worse].tolist())
    first = last = k
    while first - 1 in good:
        first -= 1
    while last + 1 in good:
        last += 1
    return float(borders[first]), float(borders[last + 1])


def _borders(term: Term, model: Model, swims: Sequence[Segments]) -> Float64 | None:
    """(k,) ascending times (s): the bounds of a law's moment, and the strokes between that the law acts on.

    None for a law without a moment, or one that does not act on strokes.
    """
    table, number = dict(term.table), _number(term)
    if number is None or table.get("on") != "stroke":
        return None
    limbs = {k for k, limb in enumerate(model.robot.limbs) if table.get("limb", ALL) in (ALL, limb.name)}
    low, high = term.parameters[number].low, term.parameters[number].high
    strokes = {at for swim in swims for at, limb in swim.strokes if limb in limbs and low < at < high}
    return np.array([low, *sorted(strokes), high])


def _number(term: Term) -> int | None:
    """Index of the parameter that is a law's moment; None without one."""
    names = [parameter.name for parameter in term.parameters]
    return names.index(MOMENT) if term.name == "law" and MOMENT in names else None


def _with_moment(model: Model, place: int, at_s: float) -> Model:
    values = list(model.terms[place].values)
    values[_number(model.terms[place]) or 0] = at_s
    return model.with_term_at(place, model.terms[place].at(values))
