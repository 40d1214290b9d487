"""The contract of a model: what the study asks of anything that forecasts."""

from abc import abstractmethod
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, Protocol

import lightning as L
import numpy as np
import torch
from torch import Tensor
from torch.nn import Parameter
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler, OneCycleLR

from study.common.arrays import Floats, Integers
from study.common.registry import Registry
from study.common.seeds import Seeds, spawn
from study.data.frames import turn
from study.data.normalization import Normalization

# Score of forecasts [V, K, T, D] against observed [V, L, T, D], SI units; smaller is better.
ValidationScore = Callable[[Floats, Floats], float]

# Steps between two points of a training curve.
LOG_EVERY = 10

# Forecast rows (scenario × sample) that are computed at once: bounds the memory.
ROWS_AT_ONCE = 8192


class Forecaster(Protocol):
    """Samples from p(s_{1:T} | s_0; a_{0:T-1}), equation (2)."""

    def forecast(self, s0: Floats, actions: Floats, samples: int, seeds: Seeds) -> Floats:
        """K forecast trajectories of each scenario, equation (3).

        Args:
            s0: [S, D] in SI units.
            actions: [S, T, A] in SI units.
            samples: K.
            seeds: [S], one for each scenario: its forecasts depend on its own seed alone, not on
                the other scenarios, their number or their order.

        Returns:
            [S, K, T, D] float32 in SI units.
        """
        ...


class Model(L.LightningModule):
    """A forecaster that is fitted: a Lightning module that works in standard units.

    A subclass gives `losses` (or a `training_step` of its own) and `sample`; it is entered with
    ``@models.register(NAME)``.

    Args:
        normalization: standard units, kept with the weights.
        settings: the sections of the configuration that the class names in `sections`.

    A class with `tunes_beta` is given `beta` as well, the weight of the KL term, and one with
    `uses_ensemble` the fitted `ensemble`.
    """

    # Part of every artifact's key: raise it whenever what is learned from the same data changes.
    version: ClassVar[int] = 1
    tunes_beta: ClassVar[bool] = False
    uses_ensemble: ClassVar[bool] = False
    sections: ClassVar[tuple[str, ...]] = ("train",)
    orders: int | None = None
    """Orders of the data in which it is trained, side by side; see `TrajectoryDataModule`."""
    noise_size: int
    """Standard normal numbers that one sample takes at one step."""
    state_mean: Tensor
    state_scale: Tensor
    action_mean: Tensor
    action_scale: Tensor
    delta_std: Tensor
    rotating_pairs: Tensor

    def __init__(self, normalization: Normalization, settings: dict[str, Any]) -> None:
        super().__init__()
        for name, values in vars(normalization).items():
            self.register_buffer(name, torch.from_numpy(np.array(values)))
        self.state_size, self.action_size = (
            len(normalization.state_mean),
            len(normalization.action_mean),
        )
        self.settings = settings
        self.validation_score: ValidationScore | None = None
        self.validation_samples, self.validation_seed = 16, 0

    @classmethod
    def trial_settings(cls, settings: dict[str, Any]) -> dict[str, Any]:
        """The settings of what a trial of the search for β fits: the model itself."""
        return settings

    @classmethod
    def budget(cls, settings: dict[str, Any]) -> dict[str, Any]:
        """The section `train` as it holds for this model: how long and how fast it is fitted.

        Args:
            settings: the sections of the configuration that the class names.
        """
        budget: dict[str, Any] = settings["train"]
        return budget

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """The ``loss`` of a batch, and parts of it that are worth a curve.

        Args:
            batch: see `TrajectoryDataModule`.
            step: steps of the optimiser that were taken before.
        """
        raise NotImplementedError(f"{type(self).__name__} needs `losses` or a `training_step`")

    def training_step(self, batch: dict[str, Tensor]) -> Tensor:
        """One batch."""
        values = self.losses(batch, self.global_step)
        self.tell(values)
        return values["loss"]

    @abstractmethod
    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """Forecasts in standard units.

        Args:
            s0: [S, D].
            actions: [S, T, A].
            noise: [S, K, T, `noise_size`], standard normal.
            member: [S, K] integers, the ensemble member of each sample (where there is one).

        Returns:
            [S, K, T, D]
        """

    def members_count(self) -> int:
        """Members among which each sample draws one for its whole horizon; 1 without an ensemble.

        What they disagree in is the model's epistemic uncertainty.
        """
        return 1

    def tell(self, values: dict[str, Tensor]) -> None:
        """Log training curves at the steps that are written: each value costs Lightning 2 ms."""
        if (self.global_step + 1) % LOG_EVERY == 0:
            self.log_dict({name: value.detach() for name, value in values.items()})

    @torch.no_grad()
    def forecast(self, s0: Floats, actions: Floats, samples: int, seeds: Seeds) -> Floats:
        """See `Forecaster.forecast`."""
        standard_s0, normalize_actions = self.normalize(
            torch.from_numpy(s0), torch.from_numpy(actions)
        )
        rows = max(1, ROWS_AT_ONCE // samples)
        parts = []
        for start in range(0, len(s0), rows):
            chunk = slice(start, start + rows)
            noise = draw_noise(seeds[chunk], samples, actions.shape[1], self.noise_size)
            member = draw_members(seeds[chunk], samples, self.members_count())
            forecasts = self.sample(
                standard_s0[chunk],
                normalize_actions[chunk],
                torch.from_numpy(noise).to(self.device),
                torch.from_numpy(member).to(self.device),
            )
            parts.append(self.denormalize(forecasts.float()).cpu().numpy())
        return np.concatenate(parts)

    def normalize(self, s0: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """s_0 [..., D] and actions [..., A] in standard units, where the weights are."""
        normalize_actions = (actions.to(self.device) - self.action_mean) / self.action_scale
        return self.normalize_states(s0), normalize_actions

    def normalize_states(self, states: Tensor) -> Tensor:
        """States [..., D] in standard units, where the weights are."""
        level = turn(states.to(self.device, copy=True), self.rotating_pairs)
        return (level - self.state_mean) / self.state_scale

    def denormalize(self, states: Tensor) -> Tensor:
        """States [..., D] in SI units, from standard units."""
        return turn(states * self.state_scale + self.state_mean, self.rotating_pairs, back=True)

    def validation_step(self, batch: dict[str, Tensor]) -> None:
        """Score free-running forecasts, the same noise at every look."""
        if self.validation_score is None:
            raise RuntimeError("set validation_score before fitting")
        s0, actions, observed = (
            batch[name].cpu().numpy() for name in ("s0", "actions", "observed")
        )
        seeds = spawn(self.validation_seed, len(s0))
        forecasts = self.forecast(s0, actions, self.validation_samples, seeds)
        score = self.validation_score(forecasts, observed)
        self.log("validation_score", score, batch_size=len(s0))

    def on_fit_start(self) -> None:
        """Lightning's hook: see `see`."""
        self.see(self.trainer.datamodule.training.tensors["states"])  # type: ignore[attr-defined]

    def see(self, states: Tensor) -> None:
        """Before fitting: the training states [N, T+1, D] in standard units."""

    def on_train_batch_start(self, *_: Any) -> None:
        """Lightning's hook: see `forgets`."""
        if self.forgets(self.global_step):
            for optimizer in self.trainer.optimizers:
                optimizer.state.clear()

    def forgets(self, step: int) -> bool:
        """Whether the optimiser forgets its averages before this step: its task changes."""
        return False

    def configure_optimizers(self) -> Any:
        """See `optimised`."""
        return self.optimised(self.settings["train"])

    def optimised(self, options: dict[str, Any]) -> dict[str, Any]:
        """What Lightning asks for: `adamw` and its `schedule`, by these options."""
        wanted = [p for p in self.parameters() if p.requires_grad]
        optimizer = adamw(wanted, options["learning_rate"], self.weight_decay(options))
        schedule = self.schedule(optimizer, options["learning_rate"], options["steps"])
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }

    def schedule(self, optimizer: Optimizer, learning_rate: float, steps: int) -> LRScheduler:
        """One cycle: the rate rises over the first tenth of the steps, then falls to nearly 0."""
        return OneCycleLR(optimizer, max_lr=learning_rate, total_steps=steps + 1, pct_start=0.1)

    def weight_decay(self, options: dict[str, Any]) -> float:
        """Its setting divided by the number of training trajectories N.

        The decay stands for a prior over the weights. Beside a loss that is an average over N
        trajectories, the prior counts 1/N: with a tenth of the data ten times as much.
        """
        return float(options["weight_decay"]) / len(self.trainer.datamodule.training)  # type: ignore[attr-defined]


def each_sample(values: Tensor, samples: int) -> Tensor:
    """Rows [S·K, ...] from [S, ...]: what all K samples of a scenario share."""
    return values.repeat_interleave(samples, dim=0)


def adamw(parameters: Iterable[Parameter], learning_rate: float, decay: float) -> Optimizer:
    """AdamW (Loshchilov and Hutter, ICLR 2019); matrices decay, biases and bounds do not.

    Each step shrinks the matrices by rate × decay.
    """
    matrices: list[Parameter] = []
    others: list[Parameter] = []
    for each in parameters:
        # The biases of networks side by side are [M, 1, ...].
        (matrices if each.dim() > 1 and each.shape[-2] > 1 else others).append(each)
    groups = [
        {"params": matrices, "weight_decay": decay},
        {"params": others, "weight_decay": 0.0},
    ]
    return torch.optim.AdamW(groups, lr=learning_rate, fused=True)


def draw_noise(seeds: Seeds, samples: int, horizon: int, size: int) -> Floats:
    """Standard normal numbers [S, K, T, size]; those of a scenario come from its seed alone."""
    noise = np.empty((len(seeds), samples, horizon, size), np.float32)
    for scenario, seed in enumerate(seeds):
        generator = np.random.default_rng([int(seed), 0])
        generator.standard_normal(dtype=np.float32, out=noise[scenario])
    return noise


def draw_members(seeds: Seeds, samples: int, members: int) -> Integers:
    """m ~ U{0 … M−1} for each sample, kept over the horizon: [S, K] (Algorithm 1, line 4)."""
    return np.stack(
        [np.random.default_rng([int(seed), 1]).integers(members, size=samples) for seed in seeds]
    )


models: Registry[type[Model]] = Registry("model")
