"""Forecasters of a results folder's cells, from the weights in the folder."""

import shutil
from dataclasses import replace
from pathlib import Path

from study.common.errors import StudyError, nearest
from study.config.grid import Cell
from study.config.names import ENSEMBLE, FROM_DATA, ORACLE
from study.envs import Simulator
from study.models import Forecaster
from study.models.checkpoints import fitted_ensemble, load_model, save_model
from study.models.oracle import Oracle
from study.models.rnn_ensemble import RnnEnsemble
from study.results import checksums
from study.results.folder import Results


def load_forecaster(results: Results, cell: Cell, simulator: Simulator) -> Forecaster:
    """The forecaster of a cell.

    Args:
        results: the results folder.
        cell: a complete cell.
        simulator: the cell's real system, with the horizon of the study.

    Raises:
        StudyError: the weights are not published, missing or damaged.
    """
    if cell.model == ORACLE:
        return Oracle(simulator)
    if cell.model == ENSEMBLE:
        return _load_ensemble(results, cell)
    if cell.model in FROM_DATA:
        raise StudyError(
            f"'{cell.name}' forecasts from the training data, which are not in {results.out}; "
            "give the cell of a model"
        )
    return load_model(_checked_path(results, cell))


def write_checkpoint(results: Results, cell: Cell, folder: Path) -> None:
    """Write a cell's weights into a folder, with the file name that the stage evaluate reads.

    Raises:
        StudyError: the weights are not published, missing or damaged.
    """
    if cell.model == ENSEMBLE:
        save_model(_load_ensemble(results, cell), ENSEMBLE, folder / "ensemble.safetensors")
    elif cell.model not in (ORACLE, *FROM_DATA):
        shutil.copyfile(_checked_path(results, cell), folder / "model.safetensors")


def _load_ensemble(results: Results, cell: Cell) -> RnnEnsemble:
    """The ensemble alone, from the file of a model that was fitted to its residuals."""
    for fitted in results.complete:
        if results.has_weights(fitted) and replace(fitted, model=ENSEMBLE) == cell:
            ensemble = fitted_ensemble(load_model(_checked_path(results, fitted)))
            if ensemble is not None:
                return ensemble
    raise StudyError(
        f"{results.out} has no weights of '{cell.name}': no model with an ensemble of this level "
        "and seed is published (see the setting publish.weights)"
    )


def _checked_path(results: Results, cell: Cell) -> Path:
    """The file of a cell's weights, checked against ``SHA256SUMS``."""
    if not results.has_weights(cell):
        weighted = filter(results.has_weights, results.complete)
        published = [complete.name for complete in weighted]
        raise StudyError(
            f"{results.out} has no weights of '{cell.name}' (see the setting publish.weights): "
            f"{nearest(cell.name, published)}"
        )
    path = results.weights(cell)
    checksums.check(path, results.out)
    return path
