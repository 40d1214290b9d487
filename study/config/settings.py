"""Every setting of the study: frozen dataclasses, one for each stage, and what each one allows.

The defaults are those of ``configs/quick.yaml``. A YAML file or a dotted flag
(``--tune.trials 12``) changes them; `study.config.validation` refuses what cannot work.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any


def setting(default: Any, **allowed: Any) -> Any:
    """A field with its bounds: `low`, `high` (both allowed) or `choices`."""
    return field(default=default, metadata=allowed)


@dataclass(frozen=True)
class Grid:
    """Which cells the study has: environment × epistemic level × model × seed.

    Args:
        environments: real systems, by their registered names.
        levels: epistemic levels: `low` has all the data, `high` a tenth of it.
        models: models, by their registered names; `paper` stands for the paper's three, `all` for
            these and those that are beyond the paper.
        seeds: initialisations, orders of data, and (level high) which tenth of the data.
    """

    environments: tuple[str, ...] = ("pusher", "uav")
    levels: tuple[str, ...] = ("low", "high")
    models: tuple[str, ...] = ("residual_vae", "full_vae", "probabilistic_mlp", "residual_crps")
    seeds: tuple[int, ...] = setting((0,), low=0)


@dataclass(frozen=True)
class Collect:
    """The observed data of one environment (stage collect).

    Args:
        trajectories: training trajectories of level low.
        reduction: level high has trajectories / reduction of them (the paper's 10).
        validation: trajectories for early stopping and tuning, the same for both levels.
        scenarios: test scenarios (the paper's 250).
        rollouts: observed rollouts K of each test scenario.
        horizon: control steps T; null is the environment's own (120 and 60).
        seed: names the data sets; the same for every cell.
    """

    trajectories: int = setting(3000, low=2)
    reduction: int = setting(10, low=1)
    validation: int = setting(128, low=2)
    scenarios: int = setting(250, low=2)
    rollouts: int = setting(40, low=2)
    horizon: int | None = setting(None, low=2)
    seed: int = setting(0, low=0)


@dataclass(frozen=True)
class Ensemble:
    """The M recurrent networks that carry the epistemic part (section III-A).

    Args:
        members: M.
        data: a member learns from all trajectories (`all`), or from all but its own share of 1/M
            (`folds`); residuals are then taken to the member that left the trajectory out, as they
            will be in a forecast. (To the CRPS generators, which score forecasts from several
            members together, that takes away how the members differ.)
        hidden_size: width of each member's GRU.
        steps: optimiser steps at most.
        batch_size: trajectories in a batch, of each member.
        learning_rate: of AdamW, at its peak (one-cycle schedule).
        weight_decay: its weight decay, times the number of training trajectories: see
            `Model.weight_decay`.
        taught: share of the steps that learn single transitions, before whole forecasts count.
        validate_every: steps between two looks at the validation data.
        patience: looks without improvement before training stops.
    """

    members: int = setting(5, low=1)
    data: str = setting("all", choices=("all", "folds"))
    hidden_size: int = setting(64, low=1)
    steps: int = setting(1000, low=1)
    batch_size: int = setting(12, low=1)
    learning_rate: float = setting(6e-3, low=1e-8, high=1.0)
    weight_decay: float = setting(100.0, low=0.0)
    taught: float = setting(0.4, low=0.0, high=1.0)
    validate_every: int = setting(100, low=1)
    patience: int = setting(6, low=1)


@dataclass(frozen=True)
class Tune:
    """The search for β (stage tune), on validation forecasts.

    Args:
        trials: values of β tried.
        beta_low: smallest β.
        beta_high: largest β; the search is uniform in log β.
        steps: optimiser steps of a trial at most.
        reports: times a trial reports its score, and may be pruned.
        validation: validation trajectories forecast at each report.
        samples: forecasts of each.
    """

    trials: int = setting(4, low=1)
    beta_low: float = setting(0.3, low=1e-12)
    beta_high: float = setting(100.0, low=1e-12)
    steps: int = setting(200, low=1)
    reports: int = setting(2, low=1)
    validation: int = setting(64, low=2)
    samples: int = setting(16, low=2)


@dataclass(frozen=True)
class Vae:
    """The two recurrent conditional VAEs (section III-B).

    Args:
        hidden_size: width of the encoder's and the decoder's GRU.
        latent_size: components of z_t.
        feeding: the decoder's state history in training: its own predictions (`free`), the true
            states (`teacher`), or first the true ones and then its own (`schedule`).
        output: the decoder gives its target (`direct`), ε_{t+1} or s_{t+1}, or the target's change
            (`increment`).
        forecast: a forecast state is drawn from p_θ(s_{t+1} | ·) (`draw`) or is its mean (`mean`).
        width: the width of p_θ depends on the past (`state`) or is the same always (`fixed`).
        encoder: the encoder sees the target and s_t, a_t (`target`), or s_{0:t}, a_{0:t} alone as
            eq. (12) is written (`history`).
        member: m is drawn for each trajectory of a batch (`sample`) or once for all (`batch`).
    """

    hidden_size: int = setting(64, low=1)
    latent_size: int = setting(8, low=1)
    feeding: str = setting("teacher", choices=("free", "teacher", "schedule"))
    output: str = setting("increment", choices=("direct", "increment"))
    forecast: str = setting("draw", choices=("draw", "mean"))
    width: str = setting("state", choices=("state", "fixed"))
    encoder: str = setting("target", choices=("target", "history"))
    member: str = setting("sample", choices=("sample", "batch"))


@dataclass(frozen=True)
class Crps:
    """The generators trained by proper scores, beyond the paper.

    Args:
        hidden_size: width of the decoder's layers.
        steps: of the optimiser, in place of `train.steps`.
        single: share of the steps that learns from single transitions, by the logarithmic score;
            the rest learns from whole trajectories, by the CRPS.
        batch_size: trajectories that single transitions are drawn from, in place of
            `train.batch_size`; whole ones are taken from among them.
        learning_rate: of AdamW at its peak, in place of `train.learning_rate`.
        noise_size: standard normal numbers that drive the decoder at each step.
        lasting: so many of them are drawn once and stay for the whole trajectory.
        samples: forecasts of each training trajectory that are scored together.
        energy: weight of the energy score of the joint state.
        increments: weight of the energy score of the joint state's change over a few steps.
    """

    hidden_size: int = setting(64, low=1)
    steps: int = setting(4000, low=1)
    single: float = setting(0.8, low=0.0, high=1.0)
    batch_size: int = setting(64, low=1)
    learning_rate: float = setting(5e-3, low=1e-8, high=1.0)
    noise_size: int = setting(12, low=1)
    lasting: int = setting(4, low=0)
    samples: int = setting(4, low=2)
    energy: float = setting(0.3, low=0.0)
    increments: float = setting(0.0, low=0.0)


@dataclass(frozen=True)
class Mlp:
    """The probabilistic MLP (section III-C).

    Args:
        hidden_size: width of each hidden layer.
        layers: hidden layers.
        likelihood: that of all transitions alike (`plain`), or the wider ones count more
            (`weighted`), as in the VAEs' likelihood: see `study/models/networks/likelihood.py`.
    """

    hidden_size: int = setting(128, low=1)
    layers: int = setting(3, low=1)
    likelihood: str = setting("weighted", choices=("plain", "weighted"))


@dataclass(frozen=True)
class ModelEnsemble:
    """Ensembles of whole models, beyond the paper.

    Args:
        members: complete models, each with weights and an order of the data of its own.
    """

    members: int = setting(5, low=1)


@dataclass(frozen=True)
class ProbabilisticEnsemble:
    """The ensemble of probabilistic MLPs.

    Args:
        propagation: a forecast keeps its member for the whole trajectory (`trajectory`, TS∞), or
            draws one anew at every step (`step`, TS1).
    """

    propagation: str = setting("trajectory", choices=("trajectory", "step"))


@dataclass(frozen=True)
class Train:
    """How the models of the cells are fitted (stage train).

    The CRPS generators have steps, batch and learning rate of their own, and never stop early.

    Args:
        steps: optimiser steps at most.
        batch_size: trajectories in a batch.
        learning_rate: of AdamW, at its peak (one-cycle schedule).
        weight_decay: its weight decay, times the number of training trajectories: see
            `Model.weight_decay`.
        validate_every: steps between two looks at the validation score.
        patience: looks without improvement before training stops.
        accelerator: Lightning's: `auto` takes a GPU where there is one.
    """

    steps: int = setting(1200, low=1)
    batch_size: int = setting(12, low=1)
    learning_rate: float = setting(8e-3, low=1e-8, high=1.0)
    weight_decay: float = setting(100.0, low=0.0)
    validate_every: int = setting(150, low=1)
    patience: int = setting(8, low=1)
    accelerator: str = setting("auto", choices=("auto", "cpu", "gpu"))


@dataclass(frozen=True)
class Evaluate:
    """Forecasts of the test scenarios and their scores (stage evaluate).

    Args:
        samples: forecasts K of each scenario.
        bandwidth: factor on the Gaussian kernel's bandwidth (1 is the median heuristic).
        examples: scenarios whose forecasts are kept for the recordings.
    """

    samples: int = setting(40, low=2)
    bandwidth: float = setting(1.0, low=1e-3, high=1e3)
    examples: int = setting(7, low=1)


@dataclass(frozen=True)
class Publish:
    """What goes from ``work/`` to the results folder. No number depends on it.

    Each names cells, by name or by pattern. Scores are published of every cell, and so are the
    recordings of the data and of the whole study.

    Args:
        forecasts: cells with their forecast recording, the largest.
        recordings: cells with their recordings of training, tuning and scores, and their part in
            the overview figure.
        weights: cells with their weights, from which `forecast` and `verify --rerun` go on.
    """

    forecasts: tuple[str, ...] = ("*",)
    recordings: tuple[str, ...] = ("*",)
    weights: tuple[str, ...] = ("*",)


@dataclass(frozen=True)
class Engine:
    """Where the stages run. No number depends on it, except on `threads` by rounding.

    Args:
        kind: `serial` (in this process) or `dask` (local worker processes).
        workers: worker processes; 0 is one for each `threads` cores.
        threads: CPU threads of each stage, whatever the number of workers.
    """

    kind: str = setting("dask", choices=("serial", "dask"))
    workers: int = setting(0, low=0)
    threads: int = setting(1, low=1)


@dataclass(frozen=True)
class Config:
    """The whole study.

    Args:
        name: names the results folder, results/NAME.
        plugins: Python modules that register environments or models of your own.
        ablations: for `ablate`, changes to try one after the other: ``vae.forecast=mean``, or
            several settings at once, ``vae.forecast=mean vae.feeding=free``.
        grid: which cells there are.
        collect: observed data.
        ensemble: the ensemble of recurrent networks.
        tune: the search for beta.
        vae: the residual VAE and the full VAE.
        mlp: the probabilistic MLP.
        crps: the generators beyond the paper.
        model_ensemble: ensembles of whole models, beyond the paper.
        probabilistic_ensemble: that of probabilistic MLPs.
        train: fitting a cell's model.
        evaluate: forecasts and scores.
        publish: what goes to the results folder.
        engine: where stages run.
    """

    name: str = "quick"
    plugins: tuple[str, ...] = ()
    ablations: tuple[str, ...] = ()
    grid: Grid = Grid()
    collect: Collect = Collect()
    ensemble: Ensemble = Ensemble()
    tune: Tune = Tune()
    vae: Vae = Vae()
    mlp: Mlp = Mlp()
    crps: Crps = Crps()
    model_ensemble: ModelEnsemble = ModelEnsemble()
    probabilistic_ensemble: ProbabilisticEnsemble = ProbabilisticEnsemble()
    train: Train = Train()
    evaluate: Evaluate = Evaluate()
    publish: Publish = Publish()
    engine: Engine = Engine()


def keys(section: type = Config, prefix: str = "") -> Iterator[str]:
    """The dotted name of every setting: ``name``, ``grid.environments``, …"""
    for entry in fields(section):
        default = entry.default
        if is_dataclass(default):
            yield from keys(type(default), f"{prefix}{entry.name}.")
        else:
            yield prefix + entry.name
