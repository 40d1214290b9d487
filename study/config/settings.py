"""Every setting of the study: frozen dataclasses, one for each section of the YAML files.

The defaults are those of ``configs/quick.yaml``. A YAML file or a dotted flag
(``--tune.trials 12``) changes a setting, and `study.config.validation` checks it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any


def setting(default: Any, **allowed: Any) -> Any:
    """A field with bounds `low` and `high`, both inclusive, or with `choices`."""
    return field(default=default, metadata=allowed)


@dataclass(frozen=True)
class Grid:
    """Which cells the study has: environment × epistemic level × model × seed.

    Args:
        environments: real systems, by their registered names.
        levels: epistemic levels: `low` has all training data, `high` a tenth of them.
        models: models, by their registered names. `paper` means the paper's three models, `all`
            means these and the models beyond the paper.
        seeds: each names initial weights, an order of the data, and at level high a tenth of the
            data.
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
        seed: of the data sets; the same for every cell.
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
    """The M recurrent networks, whose disagreement is the epistemic part (section III-A).

    Args:
        members: M.
        cross_fit: each member leaves out a fold of 1/M of the trajectories, and residuals are
            out-of-fold: taken to the member that left the trajectory out, as in a forecast. Without
            it all members learn from all trajectories, and residuals are in-sample.
        hidden_size: hidden units of each member's GRU.
        steps: optimiser steps at most.
        batch_size: trajectories in a batch, of each member.
        learning_rate: of AdamW, at its peak (one-cycle schedule).
        weight_decay: its weight decay, times the number of training trajectories: see
            `Model.weight_decay`.
        teacher_forcing_fraction: share of the steps that are teacher forced; the others train on
            autoregressive rollouts.
        validate_every: steps between two evaluations on the validation data.
        patience: evaluations without improvement before training stops.
    """

    members: int = setting(5, low=1)
    cross_fit: bool = False
    hidden_size: int = setting(64, low=1)
    steps: int = setting(1000, low=1)
    batch_size: int = setting(12, low=1)
    learning_rate: float = setting(6e-3, low=1e-8, high=1.0)
    weight_decay: float = setting(100.0, low=0.0)
    teacher_forcing_fraction: float = setting(0.4, low=0.0, high=1.0)
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
        evaluations: times a trial is evaluated, and may be pruned.
        validation: validation trajectories forecast at each evaluation.
        samples: forecasts of each.
    """

    trials: int = setting(4, low=1)
    beta_low: float = setting(0.3, low=1e-12)
    beta_high: float = setting(100.0, low=1e-12)
    steps: int = setting(200, low=1)
    evaluations: int = setting(2, low=1)
    validation: int = setting(64, low=2)
    samples: int = setting(16, low=2)


@dataclass(frozen=True)
class Vae:
    """The two recurrent conditional VAEs (section III-B).

    Args:
        hidden_size: hidden units of the encoder's and of the decoder's GRU.
        latent_size: components of z_t.
        teacher_forcing: the decoder's state history in training: the true states (`always`), its
            own predictions (`never`), or the true states first and then its own (`scheduled`).
        target: the decoder's output is ε_{t+1} or s_{t+1} itself (`state`), or its change over
            the step (`delta`).
        decoder_output: a forecast state is sampled from p_θ(s_{t+1} | ·) (`sample`) or is its
            mean (`mean`).
        variance: that of p_θ depends on the past (`heteroscedastic`) or is one number for each
            dimension (`homoscedastic`).
        encoder: the encoder sees the target and s_t, a_t (`target`), or s_{0:t}, a_{0:t} alone as
            eq. (12) is written (`history`).
        member: m is sampled for each trajectory of a batch (`trajectory`) or once for all
            (`batch`).
    """

    hidden_size: int = setting(64, low=1)
    latent_size: int = setting(8, low=1)
    teacher_forcing: str = setting("always", choices=("always", "never", "scheduled"))
    target: str = setting("delta", choices=("state", "delta"))
    decoder_output: str = setting("sample", choices=("sample", "mean"))
    variance: str = setting("heteroscedastic", choices=("heteroscedastic", "homoscedastic"))
    encoder: str = setting("target", choices=("target", "history"))
    member: str = setting("trajectory", choices=("trajectory", "batch"))


@dataclass(frozen=True)
class Crps:
    """The CRPS generators: models trained by proper scores, beyond the paper.

    Args:
        hidden_size: hidden units of each of the decoder's layers.
        steps: of the optimiser, in place of `train.steps`.
        one_step_fraction: share of the steps that trains on single transitions, by the logarithmic
            score; the others train on autoregressive rollouts, by the CRPS.
        batch_size: trajectories that single transitions are sampled from, in place of
            `train.batch_size`; rollouts start from some of them.
        learning_rate: of AdamW at its peak, in place of `train.learning_rate`.
        noise_size: standard normal numbers that drive the decoder at each step.
        persistent_noise_size: so many of them are sampled once for the whole trajectory.
        samples: forecasts of each training trajectory that are scored together.
        energy_weight: weight of the energy score of the joint state.
    """

    hidden_size: int = setting(64, low=1)
    steps: int = setting(4000, low=1)
    one_step_fraction: float = setting(0.8, low=0.0, high=1.0)
    batch_size: int = setting(64, low=1)
    learning_rate: float = setting(5e-3, low=1e-8, high=1.0)
    noise_size: int = setting(12, low=1)
    persistent_noise_size: int = setting(4, low=0)
    samples: int = setting(4, low=2)
    energy_weight: float = setting(0.3, low=0.0)


@dataclass(frozen=True)
class Mlp:
    """The probabilistic MLP (section III-C).

    Args:
        hidden_size: units of each hidden layer.
        layers: number of hidden layers.
        loss: the negative log-likelihood (`nll`), or the β-NLL (`beta_nll`), as for the VAEs: see
            `study/models/networks/likelihood.py`.
    """

    hidden_size: int = setting(128, low=1)
    layers: int = setting(3, low=1)
    loss: str = setting("beta_nll", choices=("nll", "beta_nll"))


@dataclass(frozen=True)
class ModelEnsemble:
    """Ensembles of whole models, beyond the paper.

    Args:
        members: complete models, each with its own initial weights and order of the data.
    """

    members: int = setting(5, low=1)


@dataclass(frozen=True)
class ProbabilisticEnsemble:
    """The ensemble of probabilistic MLPs.

    Args:
        propagation: a forecast keeps its member for the whole trajectory (`trajectory`, TS∞), or
            samples one at every step (`step`, TS1).
    """

    propagation: str = setting("trajectory", choices=("trajectory", "step"))


@dataclass(frozen=True)
class Train:
    """Training of the cells' models (stage train).

    The CRPS generators take steps, batch size and learning rate from their own section, and never
    stop early.

    Args:
        steps: optimiser steps at most.
        batch_size: trajectories in a batch.
        learning_rate: of AdamW, at its peak (one-cycle schedule).
        weight_decay: its weight decay, times the number of training trajectories: see
            `Model.weight_decay`.
        validate_every: steps between two evaluations of the validation score.
        patience: evaluations without improvement before training stops.
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
        bandwidth: factor on the Gaussian kernel's bandwidth; 1 is the median heuristic.
        examples: scenarios whose forecasts are stored for the recordings.
    """

    samples: int = setting(40, low=2)
    bandwidth: float = setting(1.0, low=1e-3, high=1e3)
    examples: int = setting(7, low=1)


@dataclass(frozen=True)
class Publish:
    """Which files go from ``work/`` to the results folder. No number depends on it.

    Each setting lists cells, by name or by pattern. Scores of every cell are always published, and
    so are the recordings of the data and of the whole study.

    Args:
        forecasts: cells whose forecast recording is published. It is the largest file.
        recordings: cells whose recordings of training, tuning and scores are published. Fig. 1
            shows these cells.
        weights: cells whose weights are published, for `forecast` and `verify --rerun`.
    """

    forecasts: tuple[str, ...] = ("*",)
    recordings: tuple[str, ...] = ("*",)
    weights: tuple[str, ...] = ("*",)


@dataclass(frozen=True)
class Engine:
    """Where the stages run. Numbers depend on `threads`, by rounding, and on nothing else here.

    Args:
        kind: `serial` (in this process) or `dask` (local worker processes).
        workers: worker processes; 0 starts one for each `threads` cores.
        threads: CPU threads of each stage.
    """

    kind: str = setting("dask", choices=("serial", "dask"))
    workers: int = setting(0, low=0)
    threads: int = setting(1, low=1)


@dataclass(frozen=True)
class Config:
    """The whole study.

    Args:
        name: of the results folder, results/NAME.
        plugins: Python modules of your own that register environments or models.
        ablations: for `ablate`, changes to try one after the other:
            ``vae.decoder_output=mean``, or several settings at once,
            ``vae.decoder_output=mean vae.teacher_forcing=never``.
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
        publish: files that go to the results folder.
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
