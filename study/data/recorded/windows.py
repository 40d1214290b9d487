"""Windows of T steps, cut from trajectories, and the split into training, validation and test.

The split is by trajectory: no trajectory has windows on two sides. It is random, with a seed.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.common.arrays import Floats, Integers
from study.common.counts import counted
from study.common.errors import BadInput
from study.common.progress import Progress
from study.common.seeds import derive
from study.data.readers import files_of
from study.data.recorded.description import Description
from study.data.recorded.pieces import Piece, pieces_of

SIDES = ("train", "validation", "test")
FEWEST = 2
"""Windows of each side, at least."""
LARGEST_ANGLE = 20.0
"""A logged angle beyond this is hardly in rad."""
CHUNK = 1000
"""Windows that are in memory together."""


@dataclass(frozen=True)
class Windows:
    """Windows of one side of the split, as views of their pieces.

    Attributes:
        pieces: the pieces.
        horizon: control steps T.
        index: [N, 2], piece and first row of each window.
        trajectories: the number of windows of each trajectory, by its name, in the order of
            `index`.
        unwrapped: columns of states that are angles; a window begins with them within ±π.
    """

    pieces: Sequence[Piece]
    horizon: int
    index: Integers
    trajectories: Mapping[str, int]
    unwrapped: Sequence[int]

    def __len__(self) -> int:
        return len(self.index)

    def parts(self) -> Iterator[tuple[Floats, Floats, Floats]]:
        """States [n, T+1, D], actions [n, T, A] and goals [n, G] of at most `CHUNK` windows."""
        for start in range(0, len(self), CHUNK):
            yield self._gather(self.index[start : start + CHUNK])

    def _gather(self, index: Integers) -> tuple[Floats, Floats, Floats]:
        steps, first = self.horizon, self.pieces[0]
        states = np.empty((len(index), steps + 1, first.states.shape[1]), np.float32)
        actions = np.empty((len(index), steps, first.actions.shape[1]), np.float32)
        goal = np.empty((len(index), first.goal.shape[1]), np.float32)
        for row, (piece, start) in enumerate(index):
            source = self.pieces[piece]
            states[row] = source.states[start : start + steps + 1]
            actions[row] = source.actions[start : start + steps]
            goal[row] = source.goal[start]
        for column in self.unwrapped:
            turns = np.round(states[:, :1, column] / (2 * np.pi))
            states[..., column] -= (2 * np.pi * turns).astype(np.float32)
        return states, actions, goal


@dataclass(frozen=True)
class Split:
    """The windows of all sides.

    Attributes:
        windows: by side.
        files: the logs.
        rows: rows of all pieces.
    """

    windows: Mapping[str, Windows]
    files: Sequence[Path]
    rows: int


def read_windows(
    system: Description, horizon: int, seed: int, most: Mapping[str, int], progress: Progress
) -> Split:
    """Read all logs, split their trajectories, and find the windows.

    Args:
        system: the recorded system.
        horizon: control steps T.
        seed: of the data set.
        most: largest number of windows of a side, by side; evenly chosen.
        progress: called after each log.

    Raises:
        BadInput: names the file, the column and the row; or there are too few windows.
    """
    files = files_of(system.settings.files, f"{system.name}.files")
    pieces: list[Piece] = []
    for number, path in enumerate(files, start=1):
        pieces += pieces_of(path, system)
        progress(number / len(files), f"{system.name}: {path.name}")
    if not pieces:
        raise BadInput(
            f"{system.name}: the logs have no row that can be used; check {system.name}.exclude"
        )
    _check_copies(pieces, horizon + 1)
    names = [p.trajectory for p in pieces if len(p) > horizon]
    names = list(dict.fromkeys(names))
    sides = split_names(system, names, seed, pieces, horizon)
    settings = system.settings
    stride = {"train": settings.stride}
    windows = {
        side: _windows(
            pieces,
            sides[side],
            horizon,
            stride.get(side, settings.test_stride or horizon),
            most.get(side),
            system.unwrapped,
        )
        for side in SIDES
    }
    for side in SIDES:
        if len(windows[side]) < FEWEST:
            raise BadInput(
                f"{system.name}: {counted(len(windows[side]), 'window')} of {horizon} steps for "
                f"the side '{side}'; at least {FEWEST} are needed: give a shorter horizon, a "
                "smaller stride or more logs"
            )
    return Split(windows, files, sum(map(len, pieces)))


def split_names(
    system: Description,
    names: Sequence[str],
    seed: int,
    pieces: Sequence[Piece],
    horizon: int,
) -> dict[str, list[str]]:
    """The trajectories of each side, in random order.

    Raises:
        BadInput: there are fewer than three trajectories with a window.
    """
    settings, count = system.settings, len(names)
    if count < len(SIDES):
        longest = max(map(len, pieces), default=0)
        every = len({piece.trajectory for piece in pieces})
        remedy = "a shorter horizon" if count == 0 else "more logs, or a shorter horizon"
        if longest > len(SIDES) * horizon:
            remedy = f"more logs, or {system.name}.longest_trajectory to cut long ones"
        raise BadInput(
            f"{system.name}: {count} of {counted(every, 'trajectory')} have a window of {horizon} "
            f"steps ({horizon + 1} rows; the longest has {longest}); a split needs three: give "
            f"{remedy}"
        )
    order = np.random.default_rng(derive(seed, "split")).permutation(count)
    shuffled = [names[i] for i in order]
    test, validation = (max(1, round(s * count)) for s in (settings.test, settings.validation))
    validation = min(validation, count - test - 1)
    ends = (count - test - validation, count - test)
    if min(ends[0], validation) < 1:
        raise BadInput(
            f"{system.name}: {count} trajectories, {test} of them for the test, leave too few for "
            f"training and validation; give a smaller {system.name}.test or more logs"
        )
    parts = shuffled[: ends[0]], shuffled[ends[0] : ends[1]], shuffled[ends[1] :]
    return dict(zip(SIDES, parts, strict=True))


def _windows(
    pieces: Sequence[Piece],
    names: Sequence[str],
    horizon: int,
    stride: int,
    most: int | None,
    unwrapped: Sequence[int],
) -> Windows:
    by_name: dict[str, list[int]] = {name: [] for name in names}
    for number, piece in enumerate(pieces):
        if piece.trajectory in by_name:
            by_name[piece.trajectory].append(number)
    rows = []
    for numbers in by_name.values():
        starts = [np.arange(0, len(pieces[n]) - horizon, stride) for n in numbers]
        parts = [np.stack([np.full(len(s), n), s], 1) for n, s in zip(numbers, starts, strict=True)]
        rows.append(np.concatenate(parts))
    index, owner = np.concatenate(rows), np.repeat(np.arange(len(rows)), list(map(len, rows)))
    if most is not None and len(index) > most:
        chosen = np.linspace(0, len(index) - 1, most).round().astype(np.int64)
        index, owner = index[chosen], owner[chosen]
    counts = np.bincount(owner, minlength=len(rows)).tolist()
    trajectories = dict(zip(by_name, counts, strict=True))
    return Windows(pieces, horizon, index.astype(np.int64), trajectories, unwrapped)


def _check_copies(pieces: Sequence[Piece], rows: int) -> None:
    """Check that no trajectory is a copy of another, or of its beginning.

    Args:
        pieces: of all trajectories.
        rows: of a window; shorter pieces are not used.

    Raises:
        BadInput: names the two.
    """
    by_window: dict[bytes, list[Piece]] = {}
    for piece in pieces:
        if len(piece) < rows:
            continue
        similar = by_window.setdefault(piece.digest(rows), [])
        for other in similar:
            common = min(len(piece), len(other))
            is_copy = piece.digest(common) == other.digest(common)
            if is_copy and piece.trajectory != other.trajectory:
                extent = "" if len(piece) == len(other) else f" in their first {common} rows"
                raise BadInput(
                    f"{piece.trajectory}: it has the same numbers as {other.trajectory}{extent}; "
                    "leave one of them out, since copies could be in the training set and in the "
                    "test set"
                )
        similar.append(piece)


def warnings_of(system: Description, split: Split) -> list[str]:
    """A sentence for each variable that looks wrong: constant, or in rad with values of degrees."""
    windows = split.windows["train"]
    warnings = []
    for column, variable in enumerate(system.state):
        first = windows.pieces[0].states[:1, column]
        if all((piece.states[:, column] == first).all() for piece in windows.pieces):
            warnings.append(
                f"{system.name}.state: '{variable.name}' is constant ({first[0]:g}); its forecasts "
                "say nothing"
            )
        if variable.unit != "rad" and variable.name not in system.settings.angles:
            continue
        # An unwrapped angle may turn many times, but it begins as it was logged.
        is_unwrapped = column in system.unwrapped
        values = [
            p.states[:1, column] if is_unwrapped else p.states[:, column] for p in windows.pieces
        ]
        largest = max(float(np.abs(part).max(initial=0.0)) for part in values)
        if largest > LARGEST_ANGLE:
            warnings.append(
                f"{system.name}.state: '{variable.name}' has values up to {largest:.3g} with the "
                "unit rad; is it in degrees?"
            )
    return warnings
