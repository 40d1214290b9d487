"""`check_model`: each fault of a model is found and named in one line."""

import random
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import study
from study.common.contract import CheckFailed
from study.common.errors import BadInput, StudyError
from study.common.progress import Progress
from study.data.trajectories import ScenarioSet
from study.examples.drift import Drift
from study.models import Model, models
from study.models.check import check_model
from study.models.forecasting import forecast_in_parts
from tests.helpers import models as small

S, K, T, D = 6, 5, 8, 4


INSTANCES: dict[int, int] = {}


def sample(*arguments: Any) -> Tensor:
    return Drift.sample(*arguments)


def changed(change: Callable[[Tensor], Any]) -> Callable[..., Any]:
    """The tutorial's `sample`, with its result changed."""
    return lambda *arguments: change(Drift.sample(*arguments))


def torchs_generator(self: Drift, s0: Tensor, actions: Tensor, *rest: Tensor) -> Tensor:
    forecasts = sample(self, s0, actions, *rest)
    return forecasts + torch.randn_like(forecasts)


def pythons_generator(self: Drift, s0: Tensor, actions: Tensor, *rest: Tensor) -> Tensor:
    return sample(self, s0, actions, *rest) + random.random()


def an_own_generator(self: Drift, s0: Tensor, actions: Tensor, *rest: Tensor) -> Tensor:
    forecasts = sample(self, s0, actions, *rest)
    return forecasts + float(np.random.default_rng().normal())


def the_batch(self: Drift, s0: Tensor, actions: Tensor, *rest: Tensor) -> Tensor:
    return sample(self, s0 - s0.mean(0), actions, *rest)


def order(self: Drift, s0: Tensor, actions: Tensor, *rest: Tensor) -> Tensor:
    number = torch.arange(len(s0))[:, None, None, None]
    return sample(self, s0, actions, *rest) + (number if len(s0) > 1 else 1)


def foresight(self: Drift, s0: Tensor, actions: Tensor, *rest: Tensor) -> Tensor:
    return sample(self, s0, actions, *rest) + actions.sum((1, 2))[:, None, None, None]


def in_place(self: Drift, s0: Tensor, actions: Tensor, *rest: Tensor) -> Tensor:
    forecasts = sample(self, s0, actions, *rest)
    s0 += 1
    return forecasts


def wrong_matrix(self: Drift, s0: Tensor, actions: Tensor, *rest: Tensor) -> Tensor:
    return s0 @ torch.ones(3, 3)


def remembered(self: Drift, s0: Tensor, actions: Tensor, *rest: Tensor) -> Tensor:
    """A forecast from what is neither a parameter nor a buffer."""
    number = INSTANCES.setdefault(id(self), len(INSTANCES))
    return sample(self, s0, actions, *rest) + number


def no_gradient(self: Drift, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
    return {"loss": batch["states"].mean()}


def an_infinite_gradient(self: Drift, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
    return {"loss": torch.sqrt((self.mean - self.mean.detach()).abs()).sum()}


FAULTS = [
    (
        "sample",
        changed(lambda x: x[..., :1]),
        rf"sample returned \[{S}, {K}, {T}, 1\], wanted \[{S}, {K}, {T}, {D}\]$",
    ),
    (
        "sample",
        changed(lambda x: x.repeat(1, 2, 1, 1)),
        rf"sample returned \[{S}, {2 * K}, {T}, {D}\], wanted",
    ),
    ("sample", changed(lambda x: x[:, :1]), rf"sample returned \[{S}, 1, {T}, {D}\], wanted"),
    ("sample", changed(lambda x: None), "sample returned None, wanted a tensor"),
    ("sample", changed(lambda x: x.numpy()), "sample returned a ndarray, wanted a tensor"),
    ("sample", changed(lambda x: x.long()), "sample returned int64, wanted floats"),
    ("sample", changed(lambda x: x / 0), r"sample returned -?(inf|nan) at \[0, 0, 0, 0\]"),
    ("sample", torchs_generator, "sample used the global random generator of torch; take"),
    ("sample", pythons_generator, "sample used the global random generator of Python; take"),
    ("sample", an_own_generator, "sample returned other numbers when it was called again"),
    ("sample", the_batch, "sample returned other numbers for a scenario alone than"),
    ("sample", order, "sample returned other numbers for the same scenarios in another order"),
    ("sample", foresight, "sample returned other numbers before step 4 after the actions"),
    ("sample", in_place, "sample changed its argument 1 in place; copy it first"),
    ("sample", wrong_matrix, r"sample raised RuntimeError: mat1 and mat2 .*test_check\.py, line"),
    ("sample", remembered, "sample returned other numbers after its weights were saved"),
    ("losses", lambda *_: 3.0, "losses returned a float, wanted a dict with 'loss'"),
    ("losses", lambda *_: {}, "losses returned a dict, wanted a dict with 'loss'"),
    ("losses", lambda *_: {"loss": 3.0}, r"losses \('loss'\) returned a float, wanted one number"),
    (
        "losses",
        lambda self, *_: {"loss": self.mean},
        r"\('loss'\) returned a tensor \[4\], wanted one",
    ),
    ("losses", lambda self, *_: {"loss": self.mean.sum() / 0}, r"losses \('loss'\) returned nan"),
    ("losses", no_gradient, r"losses \('loss'\) has no gradient; it depends on no parameter"),
    ("losses", an_infinite_gradient, r"losses \('loss'\) has a gradient that is not finite"),
    ("members_count", lambda self: 0, r"members_count\(\) is 0, wanted a whole number from 1 on"),
    ("on_training_data", lambda self, states: None, "on_training_data does not call super"),
    ("forecast", lambda *_: np.zeros((6, 5), np.float32), r"forecast returned \[6, 5\], wanted"),
    ("__init__", lambda self, one: None, "__init__ raised TypeError: .*positional argument"),
]


@pytest.mark.parametrize(("method", "function", "error"), FAULTS)
def test_a_fault_is_named(method: str, function: Callable[..., Any], error: str) -> None:
    with pytest.raises(CheckFailed) as caught:
        check_model(type("Broken", (Drift,), {method: function}))
    line = str(caught.value)
    assert line.startswith(("tests.models.test_check.Broken.", "the gradient of"))
    assert re.search(error, line), line
    assert "\n" not in line


def test_a_noise_size_is_needed() -> None:
    class Broken(Drift):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self.noise_size = None  # type: ignore[assignment]

    with pytest.raises(CheckFailed, match=r"noise_size is None, wanted a whole number from 0 on"):
        check_model(Broken)


def test_the_tutorials_model_has_no_fault() -> None:
    study.check_model(Drift)


@pytest.mark.parametrize("name", small.OURS)
def test_no_model_of_the_study_has_a_fault(name: str) -> None:
    check_model(models[name], small.settings(name))


def test_the_global_generators_are_left_as_they_are() -> None:
    torch.manual_seed(3)
    expected = torch.rand(2)
    torch.manual_seed(3)
    check_model(Drift)
    assert (torch.rand(2) == expected).all()


def test_forecasts_of_another_shape_are_not_broadcast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither those of a model nor those of any other forecaster."""
    model = small.model("probabilistic_mlp")
    data = small.trajectories(4)
    nothing = np.zeros((4, 0), np.float32)
    observed = data.states[:, None, 1:].repeat(3, axis=1)
    test = ScenarioSet(
        data.states[:, 0], data.actions, nothing, observed, np.zeros((4, 3, 0), np.float32), {}
    )
    seeds = np.arange(4, dtype=np.uint64)

    class Narrow:
        def forecast(self, *arguments: Any) -> Any:
            return model.forecast(*arguments)[..., :1]

    forecast_in_parts(model, test, 5, seeds, Progress())
    with pytest.raises(StudyError, match=r"Narrow\.forecast returned \[1, 5"):
        forecast_in_parts(Narrow(), test, 5, seeds, Progress())

    def one_dimension(*_: Tensor) -> Tensor:
        return torch.zeros(4, 5, 6, 1)

    monkeypatch.setattr(model, "sample", one_dimension)
    with pytest.raises(StudyError, match=r"sample returned \[4, 5, 6, 1\]"):
        model.forecast(test.s0, test.actions, 5, seeds)


def test_a_class_that_is_no_model() -> None:
    with pytest.raises(BadInput, match="is not a subclass of"):
        check_model(Model.__mro__[-1])
