"""The settings that every study has: frozen dataclasses, one for each section of the YAML files.

The defaults are those of ``configs/quick.yaml``. A YAML file or a dotted flag
(``--tune.trials 12``) changes a setting, and `study.config.tree` checks it. Models add sections of
their own: see `study.config.sections`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from study.config.names import FRACTIONS
from study.config.sections import registered, setting

LARGEST_SEED = 2**63 - 1
"""Files hold seeds as 64-bit integers."""


@dataclass(frozen=True)
class Grid:
    """Which cells the study has: environment × epistemic level × model × seed.

    Args:
        environments: real systems, by their registered names.
        levels: epistemic levels, by name: the fraction of the training data that each has, such as
            ``{low: 1.0, high: 0.1, tiny: 0.01}``. ``[low, high]`` means the paper's: all data, and
            a tenth.
        models: models, by their registered names. `paper` means the paper's three models, `all`
            means these and the models beyond the paper.
        seeds: training seeds. Each determines initial weights, the order of the data, and, at a
            level with a part of the data, which part: see `TrainingSet`.
    """

    environments: tuple[str, ...] = ("pusher", "uav")
    levels: Mapping[str, float] = field(
        default_factory=lambda: dict(FRACTIONS), metadata={"low": 1e-9, "high": 1.0}
    )
    models: tuple[str, ...] = ("residual_vae", "full_vae", "probabilistic_mlp", "full_crps")
    seeds: tuple[int, ...] = setting((0,), low=0, high=LARGEST_SEED)


@dataclass(frozen=True)
class Collect:
    """The observed data of one environment (stage collect).

    Args:
        trajectories: training trajectories of a simulator, of which each level has a fraction. A
            recorded system has all those of its logs.
        validation: trajectories for early stopping and tuning, the same for every level; at most so
            many windows of a recorded system.
        scenarios: test scenarios (the paper's 250), at most so many of a recorded system.
        rollouts: observed rollouts of each test scenario of a simulator.
        horizon: control steps T; null is the environment's own (120 and 60).
        seed: of the data sets; the same for every cell.
    """

    trajectories: int = setting(10000, low=2, high=10**6)
    validation: int = setting(128, low=2, high=10**5)
    scenarios: int = setting(250, low=2, high=10**5)
    rollouts: int = setting(40, low=2, high=10**4)
    horizon: int | None = setting(None, low=2, high=10**4)
    seed: int = setting(0, low=0, high=LARGEST_SEED)


@dataclass(frozen=True)
class Ensemble:
    """The M recurrent networks, whose disagreement is the epistemic part (section III-A).

    Args:
        members: number of networks M.
        cross_fit: each member leaves out a fold of 1/M of the trajectories, and residuals are
            out-of-fold: relative to the member that left the trajectory out, as in a forecast.
            Without it all members learn from all trajectories, and residuals are in-sample.
        hidden_size: units of each member's stem, GRU and layers.
        steps: optimiser steps at most.
        batch_size: trajectories in a batch, of each member.
        learning_rate: of AdamW, at its peak (one-cycle schedule).
        weight_decay: its weight decay, times the number of training trajectories: see
            `Model.configure_optimizers`.
        teacher_forcing_fraction: share of the steps that are teacher forced; the others train on
            autoregressive rollouts.
        symmetries: the training data are transformed by the symmetries of the environment (`all`),
            as by `train.symmetries`, or are used as they are (`none`).
        validate_every: steps between two evaluations on the validation data.
        patience: evaluations without improvement before training stops.
    """

    members: int = setting(5, low=1, high=1000)
    cross_fit: bool = False
    hidden_size: int = setting(64, low=1, high=10**4)
    steps: int = setting(1000, low=1, high=10**8)
    batch_size: int = setting(12, low=1, high=10**6)
    learning_rate: float = setting(6e-3, low=1e-8, high=1.0)
    weight_decay: float = setting(100.0, low=0.0)
    teacher_forcing_fraction: float = setting(0.4, low=0.0, high=1.0)
    symmetries: str = setting("none", choices=("none", "all"))
    validate_every: int = setting(100, low=1, high=10**8)
    patience: int = setting(6, low=1, high=10**8)


@dataclass(frozen=True)
class Tune:
    """The search for β (stage tune), on validation forecasts.

    Args:
        trials: values of β tried.
        beta_low: smallest β. With a smaller one than the default, the latent variable is used, and
            validation forecasts of the study's systems are worse.
        beta_high: largest β; the search is uniform in log β.
        steps: optimiser steps of a trial at most.
        evaluations: times a trial is evaluated, and may be pruned.
        validation: validation trajectories forecast at each evaluation.
        samples: forecasts of each.
        objective: what the search minimises on validation trajectories: the MMD² of autoregressive
            forecasts (`mmd2`), or the negative evidence lower bound with a weight of 1 (`elbo`).
        batch: trials that are proposed together, from the results of earlier batches. They may run
            at the same time on several workers. The chosen β depends on this number, and not on the
            number of workers. 1 proposes each trial from all earlier ones.
        storage: URL of a database of Optuna for all searches, postgresql://… or sqlite:///…; null
            is a journal file for each search. No number depends on it, and no file stores it, since
            it may have a password.
    """

    trials: int = setting(4, low=1, high=10**5)
    beta_low: float = setting(30.0, low=1e-12)
    beta_high: float = setting(1000.0, low=1e-12)
    steps: int = setting(200, low=1, high=10**8)
    evaluations: int = setting(2, low=1, high=10**5)
    validation: int = setting(64, low=2, high=10**5)
    samples: int = setting(16, low=2, high=10**4)
    objective: str = setting("mmd2", choices=("mmd2", "elbo"), added_later=True)
    batch: int = setting(1, low=1, high=10**5, added_later=True)
    storage: str | None = setting(None, stored=False)


@dataclass(frozen=True)
class Train:
    """Training of the cells' models (stage train).

    The CRPS generators take steps, batch size, learning rate and symmetries from their own section,
    and never stop early.

    Args:
        steps: optimiser steps at most.
        batch_size: trajectories in a batch.
        learning_rate: of AdamW, at its peak (one-cycle schedule).
        weight_decay: its weight decay, times the number of training trajectories: see
            `Model.configure_optimizers`.
        symmetries: every trajectory of a batch is transformed at random by the symmetries that the
            environment declares, such as turns and mirror images (`all`), or is used as it is
            (`none`). An environment without symmetries has no transformation.
        validate_every: steps between two evaluations of the validation score.
        patience: evaluations without improvement before training stops.
        accelerator: device of ensembles, tuning, training and evaluation. `auto` takes the CPU or
            the GPU, whichever is faster for a stage. `status` says which.
        precision: of matrix products in training: `32` (float32), `bf16` (bfloat16), or `auto`,
            which takes bfloat16 where the processor has units for it and the layers are wide.
            Recurrences and forecasts are always computed in float32.
    """

    steps: int = setting(1200, low=1, high=10**8)
    batch_size: int = setting(12, low=1, high=10**6)
    learning_rate: float = setting(1.6e-2, low=1e-8, high=1.0)
    weight_decay: float = setting(100.0, low=0.0)
    symmetries: str = setting("none", choices=("none", "all"))
    validate_every: int = setting(150, low=1, high=10**8)
    patience: int = setting(8, low=1, high=10**8)
    accelerator: str = setting("auto", choices=("auto", "cpu", "gpu"))
    precision: str = setting("32", choices=("32", "bf16", "auto"), added_later=True)


@dataclass(frozen=True)
class Evaluate:
    """Forecasts of the test scenarios and their scores (stage evaluate).

    Args:
        samples: forecasts K of each scenario.
        bandwidth: factor on the Gaussian kernel's bandwidth; 1 is the median heuristic.
        examples: scenarios whose forecasts are stored for the recordings.
    """

    samples: int = setting(40, low=2, high=10**4)
    bandwidth: float = setting(1.0, low=1e-3, high=1e3)
    examples: int = setting(7, low=1, high=10**5)


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
    """Where the stages run. Numbers depend on `threads`, by rounding, and on the hardware.

    Args:
        kind: `serial` (in this process), `dask` (worker processes), or `slurm` (worker processes in
            jobs of SLURM).
        workers: worker processes; 0 starts one for each `threads` cores. With an address, how many
            workers of the cluster are used at most; 0 uses all. With SLURM, those of all jobs at
            most; 0 is one job.
        threads: CPU threads of each stage.
        address: of an existing Dask scheduler, such as tcp://host:8786; empty starts local workers.
        retries: how often a stage is tried again after its worker was lost.
        lease: seconds after which the stage of a worker that does not renew its lease may run on
            another worker.
        cores: CPU cores of a job; `threads` of them are one worker.
        memory: of a job, such as 8GB.
        walltime: of a job, as HOURS:MINUTES:SECONDS or DAYS-HOURS:MINUTES:SECONDS. Workers end five
            minutes earlier, so that no stage may take longer.
        partition: of SLURM; empty is the default one.
        account: of SLURM, to which jobs are charged; empty is the default one.
        directives: further options of a job, such as ``--gres=gpu:1`` or ``--exclusive``.
        prologue: commands of the shell before a job's workers start, such as ``module load gcc``.
        interface: network interface between workers and scheduler, such as ib0; empty is the one of
            the machine's name.
    """

    kind: str = setting("dask", choices=("serial", "dask", "slurm"))
    workers: int = setting(0, low=0, high=1000)
    threads: int = setting(1, low=1, high=1000)
    address: str = ""
    retries: int = setting(3, low=0, high=100)
    lease: int = setting(60, low=2, high=86_400)
    cores: int = setting(1, low=1, high=1000)
    memory: str = "4GB"
    walltime: str = "04:00:00"
    partition: str = ""
    account: str = ""
    directives: tuple[str, ...] = ()
    prologue: tuple[str, ...] = ()
    interface: str = ""


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
        train: fitting a cell's model.
        evaluate: forecasts and scores.
        publish: files that go to the results folder.
        engine: where stages run.
        sections: the sections that models registered, by dotted name (`study.config.sections`).
            Those left out have their defaults.
    """

    name: str = "quick"
    plugins: tuple[str, ...] = ()
    ablations: tuple[str, ...] = ()
    grid: Grid = Grid()
    collect: Collect = Collect()
    ensemble: Ensemble = Ensemble()
    tune: Tune = Tune()
    train: Train = Train()
    evaluate: Evaluate = Evaluate()
    publish: Publish = Publish()
    engine: Engine = Engine()
    sections: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        defaults = {name: kind() for name, kind in registered().items()}
        object.__setattr__(self, "sections", defaults | dict(self.sections))

    def section(self, name: str) -> Any:
        """The section with a dotted name.

        Raises:
            KeyError: there is none.
        """
        if name in SECTIONS:
            return getattr(self, name)
        return self.sections[name] if name in self.sections else registered()[name]()


SECTIONS = tuple(entry.name for entry in fields(Config) if is_dataclass(entry.default))
"""The sections that every study has."""
