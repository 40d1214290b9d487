"""``training.rrd``: the curves of a fit, from Lightning's CSV file."""

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from study.plotting.palette import series
from study.recording import blueprints
from study.recording.properties import Properties, write_readme
from study.recording.streams import entity_path, recording, send_scalars, style_lines

KIND = "training"
TIMELINE = "step"
_README = """
# Training

Each curve is a number that was logged during the fit, by optimiser step. Hover over a curve to read
a number, drag to zoom, and double-click to show the whole curve.

- *Loss*: what the optimiser minimises on the training data.
- *Validation*: a score of forecasts on data that the model is not trained on, at each evaluation.
  Lower is better. Where it rises while the loss still falls, the model overfits.
- *KL divergence*: the information in the latent variable of a variational autoencoder. At zero the
  latent variable is unused (posterior collapse).
"""


def read_curves(path: Path) -> dict[str, pd.Series]:
    """The curves in a ``metrics.csv`` of Lightning's `CSVLogger`, by name, indexed by step.

    A metric has values at the steps at which it was logged. The epoch is not a metric.
    """
    table = pd.read_csv(path, float_precision="round_trip").set_index(TIMELINE)
    curves = {str(name): table[name].dropna() for name in table if name != "epoch"}
    return {name: curve for name, curve in curves.items() if len(curve)}


def record_training(
    path: Path, curves: Mapping[str, "pd.Series[float]"], properties: Properties
) -> None:
    """Write the recording of a fit: an entity for each curve, on the timeline `step`.

    Args:
        path: the recording.
        curves: by name, such as ``loss/kl``; each indexed by step.
        properties: of the recording.
    """
    entities = {name: entity_path(*name.split("/")) for name in curves}
    blueprint = blueprints.training(list(entities.values()))
    with recording(path, KIND, properties, blueprint) as stream:
        write_readme(stream, _README, properties)
        for index, (name, curve) in enumerate(curves.items()):
            send_scalars(stream, entities[name], TIMELINE, curve.index, curve.to_numpy())
            style_lines(stream, entities[name], [name], [series(index)])
