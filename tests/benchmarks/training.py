"""How fast models are trained: ``python -m tests.benchmarks.training``.

Transitions per second of a training step (loss, derivative and Adam) on one thread, each contender
in turn:

- *ours*: the model's `training_step`, autoregressive;
- *no compiler*: the same without a C compiler;
- *torch.nn*: the same with `Linear`, `GRUCell` and `GRU` (`tests/benchmarks/plain.py`);
- *mbrl*: for the MLP, `GaussianMLP.update` of mbrl 0.2, with as many layers and hidden units, on
  the same transitions, and in batches of 256, its default;
- *float32 limit*: the operations of the matrix products, as one large product.

For the ensemble a transition counts once for each member. mbrl is measured where it is installed:

    python -m tests.benchmarks.with_mbrl -m tests.benchmarks.training
"""

import argparse
import importlib.util
from collections.abc import Callable
from typing import Any
from unittest import mock

import torch
from torch import Tensor

from study.config.settings import Config
from study.data.trajectories import Trajectories
from study.models import Model
from study.models.networks.dynamics import DynamicsNetwork
from study.models.networks.gaussian import GaussianDynamics
from study.models.unroll import kernel
from tests.benchmarks.plain import plain
from tests.benchmarks.report import save
from tests.benchmarks.sizes import MODELS, SIZES, build_model, observe
from tests.benchmarks.timing import as_a_worker, interleave, times_as_fast

BATCH, SIDE, MBRL_BATCH = 64, 1024, 256
LARGEST_DIFFERENCE = 1e-4
"""Between our loss and that of `torch.nn`."""
Run = Callable[[], object]


def operations(name: str, model: Any) -> int:
    """Floating-point operations of the matrix products, for one transition.

    A product [rows, I] · [I, O] takes 2 I O operations a row. Its derivative by the weights takes
    as many, and that by the input again as many, unless the input is data. The pointwise
    operations, and what happens once a trajectory, are left out.
    """
    if name == "ensemble":
        layers = layers_of(model.members, model.action_size)
    elif name == "probabilistic_mlp":
        network = model.network
        layers = layers_of(network, network.features_size + model.action_size)
    else:
        encoder, decoder = model.cvae.encoder_gates_of_input, model.cvae.decoder
        hidden, posterior = model.cvae.encoder_gates_of_hidden, model.cvae.posterior
        layers = [(encoder.in_features, encoder.out_features, False)]
        layers += [(part.in_features, part.out_features, True) for part in (hidden, posterior)]
        layers += layers_of(decoder, model.condition_size())
    return sum(2 * i * o * (3 if derived else 2) for i, o, derived in layers)


def layers_of(network: DynamicsNetwork, data: int) -> list[tuple[int, int, bool]]:
    """The layers of one step: I, O, and whether there is a derivative by the input.

    Args:
        network: computes the step.
        data: how many of its inputs, the features of the state among them, are data.
    """
    shape, size, width = network.architecture, network.size, network.width
    stem, memory, x = shape.stem_size, shape.memory_size, network.features_size + shape.inputs
    of_x = 3 * memory + (size + 2 * stem if shape.product else stem)  # gates, skip and stem
    layers = [(data, of_x, False), (x - data, of_x, True)]
    layers += [(stem, 3 * memory, True), (memory, 3 * memory, True)]
    layers += [(memory + stem, stem, True)] if memory and stem else []
    layers += [(stem, stem, True)] * len(network.layers)
    outputs = 2 if isinstance(network, GaussianDynamics) else 1  # the mean and w
    return [*layers, (width, outputs * size, True)]


def batch_for(name: str, config: Config, model: Any, data: Trajectories) -> dict[str, Tensor]:
    """A training batch, as `TrajectoryDataModule` makes it."""
    states, actions = (torch.from_numpy(values) for values in (data.states, data.actions))
    batch = {
        "states": model.normalize_states(states),
        "actions": (actions - model.action_mean) / model.action_scale,
    }
    if name == "ensemble":
        streams = config.ensemble.members
        return {key: torch.stack([values] * streams) for key, values in batch.items()}
    if name == "residual_vae":
        with torch.no_grad():
            batch["members"] = model.ensemble(batch["states"][:, 0], batch["actions"])
    return batch


def loss_of(model: Model, batch: dict[str, Tensor]) -> Tensor:
    """The loss of a batch."""
    loss = model.training_step(batch)
    assert isinstance(loss, Tensor)
    return loss


def step_of(model: Model, batch: dict[str, Tensor]) -> Run:
    """One training step."""
    parameters = [parameter for parameter in model.parameters() if parameter.requires_grad]
    # With a rate of 0 every repeat computes with the same numbers.
    optimizer = torch.optim.Adam(parameters, lr=0.0)

    def step() -> None:
        optimizer.zero_grad()
        loss_of(model, batch).backward()
        optimizer.step()

    return step


def without_compiler(run: Run) -> Run:
    """The same run as with ``STUDY_COMPILED=0``."""

    def patched() -> None:
        with mock.patch.object(kernel, "library", return_value=None):
            run()

    return patched


def mbrl_steps(config: Config, batch: dict[str, Tensor], size: int) -> Run:
    """Training steps of mbrl's network on the batch's transitions, `size` of them a step."""
    from mbrl.models import GaussianMLP

    states, actions = batch["states"], batch["actions"]
    inputs = torch.cat([states[:, :-1], actions], -1).flatten(0, 1)
    targets = (states[:, 1:] - states[:, :-1]).flatten(0, 1)
    network = GaussianMLP(
        inputs.shape[1],
        targets.shape[1],
        "cpu",
        num_layers=config.section("mlp").layers,
        hid_size=config.section("mlp").hidden_size,
        learn_logvar_bounds=True,
        activation_fn_cfg={"_target_": "torch.nn.SiLU"},
    )
    optimizer = torch.optim.Adam(network.parameters(), lr=0.0)

    def steps() -> None:
        for part in zip(inputs.split(size), targets.split(size), strict=True):
            network.update(part[0], optimizer, part[1])

    return steps


def large_product() -> Run:
    """One large matrix product."""
    left, right = torch.randn(SIDE, SIDE), torch.randn(SIDE, SIDE)
    out = torch.empty(SIDE, SIDE)
    return lambda: torch.matmul(left, right, out=out)


def contenders(name: str, config: Config, data: Trajectories) -> dict[str, tuple[Run, float]]:
    """What is timed, and the transitions that it trains on."""
    model = build_model(name, config, data)
    batch = batch_for(name, config, model, data)
    step, count = step_of(model, batch), batch["actions"][..., 0].numel()
    found: dict[str, tuple[Run, float]] = {"ours": (step, count)}
    if name != "probabilistic_mlp":
        copy = plain(model)
        difference = abs(_loss(model, batch) - _loss(copy, batch))
        assert difference < LARGEST_DIFFERENCE, f"{name}: {difference}"
        found["no compiler"] = without_compiler(step), count
        found["torch.nn"] = step_of(copy, batch), count
    elif importlib.util.find_spec("mbrl"):
        found["mbrl"] = mbrl_steps(config, batch, count), count
        found[f"mbrl, batches of {MBRL_BATCH}"] = mbrl_steps(config, batch, MBRL_BATCH), count
    found["float32 limit"] = large_product(), 2 * SIDE**3 / operations(name, model)
    return found


def _loss(model: Model, batch: dict[str, Tensor]) -> float:
    torch.manual_seed(0)
    with torch.no_grad():
        return float(loss_of(model, batch))


def measure(size: str, name: str, data: Trajectories, repeats: int) -> list[dict[str, Any]]:
    """The rows of one model and size."""
    timed = contenders(name, SIZES[size], data)
    timings = interleave({label: run for label, (run, _) in timed.items()}, repeats)
    ours = timed["ours"][1]
    return [
        {
            "size": size,
            "model": name,
            "contender": label,
            "rate": count / timings[label].median(),
            "ratio": times_as_fast(timings["ours"], timings[label], ours / count),
        }
        for label, (_, count) in timed.items()
    ]


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--environment", default="pusher")
    parser.add_argument("--repeats", type=int, default=9)
    arguments = parser.parse_args()
    as_a_worker()
    data = observe(arguments.environment, BATCH)
    rows = []
    for size in SIZES:
        for name in MODELS:
            measured = measure(size, name, data, arguments.repeats)
            for row in measured:
                label = "{size:6} {model:18} {contender:22}".format(**row)
                print(f"{label} {row['rate']:12,.0f} /s; ours × {row['ratio'][0]:.2f}", flush=True)
            rows += measured
    save("training", rows)


if __name__ == "__main__":
    main()
