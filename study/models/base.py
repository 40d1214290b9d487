"""The protocol of a forecaster, and the base class of trained forecasters."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import asdict, fields, is_dataclass
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import lightning as L
import numpy as np
import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from study.common.arrays import Floats
from study.common.errors import BadInput, StudyError, nearest
from study.common.registry import Registry, full_name, missing
from study.common.seeds import Seeds
from study.config.sections import PREFIX, register_own, registered, sections_of
from study.config.settings import SECTIONS, Config, Train
from study.data.frames import to_fixed_frame, to_rotating_frame
from study.data.normalization import Normalization
from study.models.optimizer import adamw, one_cycle
from study.models.sampling import sample_members, sample_noise

LOG_EVERY = 10
"""Optimiser steps between two points of a training curve."""

MAX_ROWS = 8192
"""Largest number of forecasts (scenario × sample) in one batch. It bounds the memory."""


class Forecaster(Protocol):
    """Samples from p(s_{1:T} | s_0; a_{0:T-1}), equation (2)."""

    def forecast(self, s0: Floats, actions: Floats, samples: int, seeds: Seeds) -> Floats:
        """K forecast trajectories of each scenario, equation (3).

        Args:
            s0: [S, D] in SI units.
            actions: [S, T, A] in SI units.
            samples: K.
            seeds: [S]. A scenario's forecasts depend on its own seed alone, not on the other
                scenarios, their number or their order.

        Returns:
            [S, K, T, D] float32 in SI units.
        """
        ...


class ModelSettings(Protocol):
    """The settings that every model has: its training options."""

    @property
    def train(self) -> Train:
        """The training options."""
        ...


S = TypeVar("S", bound=ModelSettings)


class Model(L.LightningModule, Generic[S]):
    """A forecaster that is trained: a Lightning module that works in normalised units.

    A subclass implements `losses` (or `training_step`) and `sample`, and is registered with
    ``@models.register(NAME)``.

    Args:
        normalization: units of states and actions; saved with the weights.
        settings: an instance of `settings_class`.

    A class with `tunes_beta` takes a third argument `beta`, the weight of the KL divergence. A
    class with `uses_ensemble` takes a last argument `ensemble`, the fitted `RnnEnsemble`, and
    stores it in the attribute `ensemble`.
    """

    settings_class: ClassVar[type[Any]]
    """A frozen dataclass: the part of the configuration that the model reads.

    A field whose type is a dataclass is the section of that name, such as ``train: Train``. Every
    other field is a setting of this model alone, ``--model.NAME.FIELD``, and has a default:
    ``size: int = setting(8, low=1)``. The dataclass may raise `ValueError` in ``__post_init__``.
    """
    tunes_beta: ClassVar[bool] = False
    uses_ensemble: ClassVar[bool] = False
    data_streams: int | None = None
    """Number of independently shuffled streams of training data, one for each network that is
    trained in parallel. None is one stream, without the leading axis in the batches."""
    noise_size: int
    """Number of standard normal numbers that one sample needs at each step."""
    training_size: int
    """Number of training trajectories N, see `on_training_data`."""

    state_mean: Tensor
    state_scale: Tensor
    action_mean: Tensor
    action_scale: Tensor
    delta_std: Tensor
    rotating_pairs: Tensor

    def __init__(self, normalization: Normalization, settings: S) -> None:
        super().__init__()
        for name, values in asdict(normalization).items():
            self.register_buffer(name, torch.from_numpy(values))
        self.state_size = len(normalization.state_mean)
        self.action_size = len(normalization.action_mean)
        self.settings = settings

    @classmethod
    def settings_from(cls, config: Config, name: str = "") -> S:
        """The settings of this model: sections of a configuration, and those of this model alone.

        Args:
            config: the configuration.
            name: registered name of the model. The section ``model.NAME`` has the settings of this
                model alone. Without a name, or without this section, they have their defaults.

        Raises:
            BadInput: a field of `settings_class` is no section of the configuration, or the class
                does not accept the values.
        """
        check_sections(cls)
        own_section = PREFIX + name
        values = asdict(config.section(own_section)) if own_section in registered() else {}
        values |= {section: config.section(section) for section in sections_of(cls.settings_class)}
        try:
            return cls.settings_class(**values)
        except ValueError as error:
            raise BadInput(f"{own_section}: {' '.join(str(error).split())}") from None

    @classmethod
    def training_options(cls, settings: S) -> Train:
        """The training options of this model: the section `train`, unless a subclass changes it."""
        return settings.train

    @classmethod
    def trial_settings(cls, settings: S) -> S:
        """The settings of the model that a trial of the search for β fits."""
        return settings

    @abstractmethod
    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """Forecasts in normalised units.

        Args:
            s0: [S, D].
            actions: [S, T, A].
            noise: [S, K, T, `noise_size`], standard normal.
            member: [S, K] integers below `members_count()`: the ensemble member of each sample.

        Returns:
            [S, K, T, D]
        """

    def members_count(self) -> int:
        """The number of members; 1 without an ensemble.

        A sample belongs to one member over its whole horizon. The disagreement of the members is
        the model's epistemic uncertainty.
        """
        return 1

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """The ``loss`` of a batch, a scalar, and further scalars for the training curves.

        Args:
            batch: see `study.training.data_module.TrajectoryDataModule`.
            step: the number of optimiser steps already taken.
        """
        raise NotImplementedError(f"{type(self).__name__} needs `losses` or a `training_step`")

    def on_training_data(self, states: Tensor) -> None:
        """Called once before training.

        Args:
            states: the training states [N, T+1, D] in normalised units.
        """
        self.training_size = len(states)

    def resets_optimizer_at(self, step: int) -> bool:
        """Whether the optimiser's moment estimates are discarded before this step."""
        return False

    def diagnostics(self, batch: dict[str, Tensor]) -> dict[str, float]:
        """Numbers about the fitted model, which the stage train writes to ``fit.json``.

        Args:
            batch: observed validation trajectories, with the entries of a batch of `losses`.
        """
        return {}

    def negative_elbo(self, batch: dict[str, Tensor]) -> float:
        """E_q[−log p] + KL of the batch of `diagnostics`, whatever β is, in nats a step.

        Raises:
            StudyError: the class has no evidence lower bound.
        """
        lacks = f"{full_name(type(self))} has no negative_elbo"
        raise StudyError(f"{lacks}: set tune.objective to mmd2")

    @torch.no_grad()
    def forecast(self, s0: Floats, actions: Floats, samples: int, seeds: Seeds) -> Floats:
        """See `Forecaster.forecast`."""
        normalized_s0, normalized_actions = self.normalize(
            torch.from_numpy(s0), torch.from_numpy(actions)
        )
        rows = max(1, MAX_ROWS // samples)
        parts = []
        for start in range(0, len(s0), rows):
            chunk = slice(start, start + rows)
            noise = sample_noise(seeds[chunk], samples, actions.shape[1], self.noise_size)
            member = sample_members(seeds[chunk], samples, self.members_count())
            forecasts = self.sample(
                normalized_s0[chunk],
                normalized_actions[chunk],
                torch.from_numpy(noise).to(self.device),
                torch.from_numpy(member).to(self.device),
            )
            expected = (*noise.shape[:3], self.state_size)
            if not isinstance(forecasts, Tensor) or forecasts.shape != expected:
                returned = list(forecasts.shape) if isinstance(forecasts, Tensor) else forecasts
                raise StudyError(
                    f"{full_name(type(self))}.sample returned {returned!r:.60}, "
                    f"wanted {list(expected)}"
                )
            parts.append(self.denormalize(forecasts.float()).cpu().numpy())
        return np.concatenate(parts)

    def normalize(self, s0: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """s_0 [..., D] and actions [..., A] from SI to normalised units, on the model's device."""
        normalized_actions = (actions.to(self.device) - self.action_mean) / self.action_scale
        return self.normalize_states(s0), normalized_actions

    def normalize_states(self, states: Tensor) -> Tensor:
        """States [..., D] from SI to normalised units, on the model's device."""
        fixed = to_fixed_frame(states.to(self.device, copy=True), self.rotating_pairs)
        return (fixed - self.state_mean) / self.state_scale

    def denormalize(self, states: Tensor) -> Tensor:
        """States [..., D] from normalised to SI units."""
        return to_rotating_frame(states * self.state_scale + self.state_mean, self.rotating_pairs)

    def training_step(self, batch: dict[str, Tensor]) -> Tensor:
        """The loss of one batch."""
        values = self.losses(batch, self.global_step)
        self.log_curves(values)
        return values["loss"]

    def validation_step(self, batch: dict[str, Tensor]) -> None:
        """Does nothing: the training callback scores the model's forecasts.

        A model with another validation loss overrides this method and logs the loss as
        ``validation_score``.
        """

    def log_curves(self, values: dict[str, Tensor]) -> None:
        """Log values at every `LOG_EVERY`-th step, since Lightning takes 2 ms for each value."""
        if (self.global_step + 1) % LOG_EVERY == 0:
            self.log_dict({name: value.detach() for name, value in values.items()})

    def on_train_batch_start(self, *_: Any) -> None:
        """Lightning's hook: see `resets_optimizer_at`."""
        if self.resets_optimizer_at(self.global_step):
            for optimizer in self.trainer.optimizers:
                optimizer.state.clear()

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Lightning's hook: AdamW and its learning rate, by the training options.

        The weight decay is the setting divided by the number of training trajectories N. It stands
        for a prior over the weights. In a loss averaged over N trajectories, a prior counts 1/N.
        """
        options = self.training_options(self.settings)
        trained = [parameter for parameter in self.parameters() if parameter.requires_grad]
        decay = options.weight_decay / self.training_size
        optimizer = adamw(trained, options.learning_rate, decay)
        schedule = self.schedule(optimizer, options.learning_rate, options.steps)
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }

    def schedule(self, optimizer: Optimizer, learning_rate: float, steps: int) -> LRScheduler:
        """The learning rate of every step."""
        return one_cycle(optimizer, learning_rate, steps)


def check_class(model: Any) -> None:
    """Check a model class without an instance, before it is registered.

    Raises:
        BadInput: the class is no model, or lacks an attribute or a method.
    """
    subject = full_name(model)
    if not (isinstance(model, type) and issubclass(model, Model)):
        raise BadInput(f"{subject} is not a subclass of study.models.Model")
    lacks = missing(model, ("settings_class",))
    if model.losses is Model.losses and model.training_step is Model.training_step:
        lacks.append("losses")
    if lacks:
        raise BadInput(f"{subject} lacks {', '.join(lacks)}: see study.models.Model")
    settings = model.settings_class
    if not is_dataclass(settings) or not settings.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        raise BadInput(
            f"{subject}.settings_class: got {settings!r:.60}; a frozen dataclass is needed"
        )
    if "train" not in [entry.name for entry in fields(settings)]:
        raise BadInput(f"{subject}.settings_class: {settings.__name__} lacks train: Train")


def check_sections(model: type[Model[Any]]) -> None:
    """Check that the configuration has the sections that a class reads.

    Raises:
        BadInput: the configuration lacks a section.
    """
    sections = [*SECTIONS, *(name for name in registered() if not name.startswith(PREFIX))]
    for name in sections_of(model.settings_class):
        if name not in sections:
            raise BadInput(
                f"{full_name(model)}: the configuration has no section '{name}'; "
                f"{nearest(name, sections)}"
            )


class ModelRegistry(Registry[type[Model[Any]]]):
    """Models by name. The registration of a model also registers its section ``model.NAME``."""

    def register(self, name: str) -> Callable[[type[Model[Any]]], type[Model[Any]]]:
        """See `Registry.register`."""
        register = super().register(name)

        def decorate(model: type[Model[Any]]) -> type[Model[Any]]:
            decorated = register(model)
            check_sections(model)
            register_own(name, model.settings_class)
            return decorated

        return decorate


models = ModelRegistry("model", check_class)
"""The trained forecasters by name."""
