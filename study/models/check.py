"""Check that a model keeps the contract of `Model`, like Gymnasium's `check_env`.

::

    import study
    study.check_model(MyModel)
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from study.common.arrays import Array
from study.common.contract import (
    CheckFailed,
    call,
    expect_array,
    expect_same,
    preserved_generators,
)
from study.common.registry import full_name
from study.common.seeds import spawn
from study.config.settings import Config, Ensemble
from study.data.normalization import Normalization
from study.data.trajectories import Trajectories
from study.models.base import Model, check_class
from study.models.checkpoints import construct
from study.models.rnn_ensemble import RnnEnsemble, RnnEnsembleSettings
from study.models.sampling import sample_members, sample_noise

SCENARIOS, SAMPLES, HORIZON = 6, 5, 8
"""S, K and the largest T of the forecasts in the checks."""
BETA = 1.0
"""β of a class with `tunes_beta`."""


@dataclass(frozen=True)
class Inputs:
    """The data and the settings with which a model is checked.

    Attributes:
        trajectories: a few training trajectories.
        normalization: of the whole training set.
        settings: an instance of the class's `settings_class`.
    """

    trajectories: Trajectories
    normalization: Normalization
    settings: Any

    @classmethod
    def random(cls, settings: Any) -> "Inputs":
        """Random walks with states of size 4 and actions of size 2."""
        generator = np.random.default_rng(0)
        actions = generator.normal(size=(16, HORIZON, 2)).astype(np.float32)
        changes = generator.normal(size=(16, HORIZON + 1, 4)) * [1.0, 5.0, 0.1, 0.5] + 1.0
        states, empty = changes.cumsum(axis=1).astype(np.float32), np.zeros((16, 0), np.float32)
        trajectories = Trajectories(states, actions, empty, empty, {})
        return cls(trajectories, Normalization.from_trajectories(trajectories), settings)


def check_model(
    model: type[Model[Any]], settings: Any = None, inputs: Inputs | None = None
) -> None:
    """Check a class: attributes, losses, shapes, noise, causality, weights and forecasts.

    Args:
        model: the class; it need not be registered.
        settings: an instance of `model.settings_class`; None takes the defaults.
        inputs: training data; None takes random trajectories.

    Raises:
        BadInput: the class lacks an attribute or a method.
        CheckFailed: a method does not keep the contract of `Model`.
    """
    check_class(model)
    if inputs is None:
        inputs = Inputs.random(model.settings_from(Config()) if settings is None else settings)
    with preserved_generators():
        torch.manual_seed(0)
        _Check(model, inputs).run()


class _Check:
    """The checks of one class."""

    def __init__(self, model_class: type[Model[Any]], inputs: Inputs) -> None:
        self.name, self.model_class = full_name(model_class), model_class
        self.inputs, normalization = inputs, inputs.normalization
        self.states = normalization.normalize_states(inputs.trajectories.states[:, : HORIZON + 1])
        self.actions = normalization.normalize_actions(inputs.trajectories.actions[:, :HORIZON])
        self.horizon = self.actions.shape[1]
        self.ensemble = None
        if model_class.uses_ensemble:
            small = RnnEnsembleSettings(Ensemble(members=2, hidden_size=8))
            self.ensemble = RnnEnsemble(normalization, small).eval()
            self.ensemble.on_training_data(self.states)
        self.model = self.build()
        count = min(SCENARIOS, len(self.states))
        self.shape = (count, SAMPLES, self.horizon, self.states.shape[-1])

    def build(self) -> Model[Any]:
        """A new model."""
        arguments = (self.inputs.normalization, self.inputs.settings, BETA, self.ensemble)
        subject = f"{self.name}.__init__"
        model: Model[Any] = call(subject, construct, self.model_class, *arguments, seeded=False)
        if not hasattr(model, "state_mean"):
            raise CheckFailed(f"{subject} does not call super().__init__")
        subject = f"{self.name}.on_training_data"
        call(subject, model.on_training_data, self.states, seeded=False)
        if not hasattr(model, "training_size"):
            raise CheckFailed(f"{subject} does not call super().on_training_data")
        return model

    def run(self) -> None:
        """Run all checks.

        Raises:
            CheckFailed: a check failed.
        """
        self.numbers()
        if self.model_class.losses is not Model.losses:
            self.losses()
        self.model.eval()
        with torch.no_grad():
            self.samples()
            self.forecasts()

    def numbers(self) -> None:
        """Check `noise_size`, `members_count` and `data_streams`."""
        for name, value, least in (
            ("noise_size", getattr(self.model, "noise_size", None), 0),
            ("members_count()", call(f"{self.name}.members_count", self.model.members_count), 1),
            ("data_streams", self.model.data_streams, 1),
        ):
            if name == "data_streams" and value is None:
                continue
            if not isinstance(value, int | np.integer) or value < least:
                raise CheckFailed(
                    f"{self.name}.{name} is {value!r:.40}, wanted a whole number from {least} on"
                )

    def losses(self) -> None:
        """Check `losses` of a batch, and their gradient."""
        subject, batch = f"{self.name}.losses", self.batch()
        self.model.train()
        values = call(subject, self.model.losses, batch, 0, seeded=False)
        if not isinstance(values, Mapping) or "loss" not in values:
            raise CheckFailed(f"{subject} returned {_kind(values)}, wanted a dict with 'loss'")
        for name, value in values.items():
            if not isinstance(value, Tensor) or value.numel() != 1:
                raise CheckFailed(
                    f"{subject} ('{name}') returned {_kind(value)}, wanted one number"
                )
            if not torch.isfinite(value).all():
                raise CheckFailed(f"{subject} ('{name}') returned {value.item()}")
        if not values["loss"].requires_grad:
            raise CheckFailed(f"{subject} ('loss') has no gradient; it depends on no parameter")
        call(f"the gradient of {subject}", values["loss"].backward, seeded=False)
        gradients = [p.grad for p in self.model.parameters() if p.grad is not None]
        if not all(torch.isfinite(gradient).all() for gradient in gradients):
            raise CheckFailed(f"{subject} ('loss') has a gradient that is not finite")
        self.model.zero_grad()

    def batch(self) -> dict[str, Tensor]:
        """A training batch, see `study.training.data_module`."""
        batch = {"states": self.states, "actions": self.actions}
        if self.ensemble is not None:
            with torch.no_grad():
                batch["members"] = self.ensemble(self.states[:, 0], self.actions)
        streams = self.model.data_streams
        if streams is None:
            return batch
        return {name: value.expand(streams, *value.shape).clone() for name, value in batch.items()}

    def samples(self) -> None:
        """Check `sample`: shape, noise, independence of the batch, causality, and saved weights."""
        count, samples, horizon, _ = self.shape
        seeds = spawn(0, count)
        s0, actions = self.states[:count, 0], self.actions[:count]
        noise = torch.from_numpy(sample_noise(seeds, samples, horizon, self.model.noise_size))
        member = torch.from_numpy(sample_members(seeds, samples, self.model.members_count()))
        expected = self.sample(self.model, s0, actions, noise, member)
        subject = f"{self.name}.sample"
        for rows, difference in (
            (list(range(count)), "when it was called again with the same noise"),
            ([1], "for a scenario alone than for the same scenario in a batch"),
            (list(range(count))[::-1], "for the same scenarios in another order"),
        ):
            part = (s0[rows], actions[rows], noise[rows], member[rows])
            expect_same(subject, self.sample(self.model, *part), expected[rows], difference)
        late, changed = horizon // 2, actions.clone()
        changed[:, late:] = 1.0 - changed[:, late:]
        forecasts = self.sample(self.model, s0, changed, noise, member)
        difference = f"before step {late} after the actions from there on were changed"
        expect_same(subject, forecasts[:, :, :late], expected[:, :, :late], difference)
        loaded = self.build()
        weights = self.model.state_dict()
        call(f"{self.name}.load_state_dict", loaded.load_state_dict, weights, seeded=False)
        forecasts = self.sample(loaded.eval(), s0, actions, noise, member)
        difference = (
            "after its weights were saved and loaded; what a forecast needs is a parameter or "
            "a buffer, or follows from the settings"
        )
        expect_same(subject, forecasts, expected, difference)

    def sample(self, model: Model[Any], *inputs: Tensor) -> Array:
        """Call `sample`, and check the type and the shape of the result."""
        subject = f"{self.name}.sample"
        forecasts = call(subject, model.sample, *inputs)
        if not isinstance(forecasts, Tensor):
            raise CheckFailed(f"{subject} returned {_kind(forecasts)}, wanted a tensor")
        array: Array = forecasts.detach().numpy()
        expect_array(subject, array, (len(inputs[0]), *self.shape[1:]), None)
        return array

    def forecasts(self) -> None:
        """Check `forecast`: its shape, and that a scenario depends on its own seed alone."""
        count, samples, horizon, _ = self.shape
        data, seeds, subject = self.inputs.trajectories, spawn(1, count), f"{self.name}.forecast"
        s0 = np.ascontiguousarray(data.states[:count, 0])
        actions = np.ascontiguousarray(data.actions[:count, :horizon])
        batch = call(subject, self.model.forecast, s0, actions, samples, seeds)
        expect_array(subject, batch, self.shape)
        alone = call(subject, self.model.forecast, s0[1:2], actions[1:2], samples, seeds[1:2])
        expect_array(subject, alone, (1, *self.shape[1:]))
        difference = "for a scenario alone than for the same scenario in a batch"
        expect_same(subject, alone, batch[1:2], difference)


def _kind(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"a tensor {list(value.shape)}"
    return "None" if value is None else f"a {type(value).__name__}"
