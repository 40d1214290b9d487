"""How fast models are trained: ``python -m tests.benchmarks.training``.

Transitions per second of a whole step, loss, derivative and Adam, on one thread, in turn:

- *ours*: the model's `training_step`, free running; *in plain torch*: the same without a compiler;
- *torch.nn*: as one would write it with `GRUCell` and `GRU` (`tests/benchmarks/plain.py`);
- *mbrl*: for the MLP, `GaussianMLP.update` of mbrl 0.2, a network of the same width, on the same
  transitions, and in batches of 256, its own default;
- *float32 limit*: the matrix products' operations alone, as one large product; and in *bfloat16*,
  where the processor has instructions for it.

For the ensemble a transition counts once for each member that learns from it. mbrl is measured
where it is installed; to have it for this script alone:

    python -m tests.benchmarks.with_mbrl -m tests.benchmarks.training
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from torch import Tensor

from study.config.settings import Config
from study.data.trajectories import Trajectories
from study.models import Model
from study.models.gru import native
from tests.benchmarks.plain import plain
from tests.benchmarks.sizes import MODELS, SIZES, built, observe
from tests.benchmarks.timing import as_a_worker, interleave, times_as_fast, verdict

PLAIN_TARGET, MBRL_TARGET, LIMIT_TARGET = 2.5, 2.0, 1.0
BATCH, SIDE, MBRL_BATCH = 64, 1024, 256
Run = Callable[[], object]


def operations(name: str, config: Config, state: int, action: int) -> int:
    """Floating-point operations of the matrix products, for one transition.

    A product [rows, I] · [I, O] takes 2 I O operations a row, its derivative by the weights as
    many, and by the input again as many, where the input has one: data have none. The gates'
    pointwise operations and what happens once a trajectory are left out.
    """
    latent = config.vae.latent_size
    hidden = config.ensemble.hidden_size if name == "ensemble" else config.vae.hidden_size
    layers: list[tuple[int, int, bool]]  # I, O, whether the input has a derivative
    if name == "ensemble":
        layers = [(action, 3 * hidden, False), (state, 3 * hidden, True)]
        layers += [(hidden, 3 * hidden, True), (hidden, state, True)]
    elif name == "probabilistic_mlp":
        width = config.mlp.hidden_size
        layers = [(state + action, width, False)]
        layers += [(width, width, True)] * (config.mlp.layers - 1) + [(width, 2 * state, True)]
    else:
        condition = action + (state if name == "residual_vae" else 0)
        layers = [(2 * state + condition, 3 * hidden, False), (hidden, 3 * hidden, True)]
        layers += [(hidden, 2 * latent, True)]  # the encoder ends, the decoder begins
        layers += [(condition, 3 * hidden, False), (latent + state, 3 * hidden, True)]
        layers += [(hidden, 3 * hidden, True), (hidden, 2 * state, True)]
    return sum(2 * i * o * (3 if derived else 2) for i, o, derived in layers)


def batch_for(name: str, config: Config, model: Model, data: Trajectories) -> dict[str, Tensor]:
    """A training batch, as `TrajectoryDataModule` gives it."""
    state_scale, action_scale = model.state_scale, model.action_scale
    states = (torch.from_numpy(data.states) - model.state_mean) / state_scale
    actions = (torch.from_numpy(data.actions) - model.action_mean) / action_scale
    batch = {"states": states, "actions": actions}
    count = config.ensemble.members
    if name == "ensemble":
        return {key: torch.stack([each] * count) for key, each in batch.items()}
    if name == "residual_vae":
        with torch.no_grad():
            batch["members"] = model.ensemble(states[:, 0], actions)  # type: ignore[operator]
    return batch


def loss_of(model: Model, batch: dict[str, Tensor]) -> Tensor:
    """The loss of a batch."""
    loss = model.training_step(batch)
    assert isinstance(loss, Tensor)
    return loss


def step_of(model: Model, batch: dict[str, Tensor]) -> Run:
    """One step of training."""
    wanted = [parameter for parameter in model.parameters() if parameter.requires_grad]
    # Of no size: every repeat does the same arithmetic, on numbers of the same kind.
    optimizer = torch.optim.Adam(wanted, lr=0.0)

    def step() -> None:
        optimizer.zero_grad()
        loss_of(model, batch).backward()
        optimizer.step()

    return step


def without_compiler(run: Run) -> Run:
    """The same where no library was built, as with ``STUDY_COMPILED=0``."""

    def plainly() -> None:
        with mock.patch.object(native, "library", return_value=None):
            run()

    return plainly


def mbrl_steps(config: Config, batch: dict[str, Tensor], size: int) -> Run:
    """mbrl's network on the batch's transitions, so many of them a step."""
    from mbrl.models import GaussianMLP

    states, actions = batch["states"], batch["actions"]
    seen = torch.cat([states[:, :-1], actions], -1).flatten(0, 1)
    change = (states[:, 1:] - states[:, :-1]).flatten(0, 1)
    network = GaussianMLP(
        seen.shape[1],
        change.shape[1],
        "cpu",
        num_layers=config.mlp.layers,
        hid_size=config.mlp.hidden_size,
        learn_logvar_bounds=True,
        activation_fn_cfg={"_target_": "torch.nn.SiLU"},
    )
    optimizer = torch.optim.Adam(network.parameters(), lr=0.0)

    def steps() -> None:
        for part in zip(seen.split(size), change.split(size), strict=True):
            network.update(part[0], optimizer, part[1])

    return steps


def product_of(dtype: torch.dtype) -> Run:
    """One large matrix product."""
    left, right = (torch.randn(SIDE, SIDE).to(dtype) for _ in range(2))
    out = torch.empty(SIDE, SIDE, dtype=dtype)
    return lambda: torch.matmul(left, right, out=out)


def has_bfloat16() -> bool:
    """Whether the processor has instructions for it; without them a product takes minutes."""
    try:
        flags = Path("/proc/cpuinfo").read_text().split()
    except OSError:
        return False
    return "avx512_bf16" in flags or "amx_bf16" in flags


def has_mbrl() -> bool:
    """Whether mbrl and what it needs is installed."""
    try:
        import mbrl.models  # noqa: F401
    except ImportError:
        return False
    return True


def measure(name: str, config: Config, data: Trajectories, repeats: int) -> dict[str, float]:
    """Print one model's table; ratios by contender."""
    model = built(name, config, data)
    batch = batch_for(name, config, model, data)
    step = step_of(model, batch)
    transitions = batch["actions"][..., 0].numel()
    needed = operations(name, config, model.state_size, model.action_size) * transitions
    runs: dict[str, tuple[Run, float]] = {"ours": (step, 1.0)}  # with the work of each, by ours
    if name != "probabilistic_mlp":
        rival = plain(model)
        apart = _loss(model, batch) - _loss(rival, batch)
        assert abs(apart) < 1e-4, f"the loss of torch.nn is off by {apart}"
        runs["ours in plain torch"] = without_compiler(step), 1.0
        runs["torch.nn"] = step_of(rival, batch), 1.0
    elif has_mbrl():
        runs["mbrl"] = mbrl_steps(config, batch, transitions), 1.0
        runs[f"mbrl, batches of {MBRL_BATCH}"] = mbrl_steps(config, batch, MBRL_BATCH), 1.0
    runs["float32 limit"] = product_of(torch.float32), 2 * SIDE**3 / needed
    if has_bfloat16():
        runs["bfloat16 limit"] = product_of(torch.bfloat16), 2 * SIDE**3 / needed
    timings = interleave({label: run for label, (run, _) in runs.items()}, repeats)
    ratios = {}
    for label, (_, work) in runs.items():
        rate = work * transitions / timings[label].median()
        ratio, least, most = times_as_fast(timings["ours"], timings[label], 1 / work)
        clock = work * transitions / float(torch.tensor(timings[label].clock).median())
        ratios[label] = ratio
        print(
            f"  {name:17} {label:22} {rate:11,.0f} /s {clock:11,.0f} /s by the clock"
            f"   ours is {ratio:5.2f} × ({least:.2f} to {most:.2f})"
        )
    return ratios


def _loss(model: Model, batch: dict[str, Tensor]) -> float:
    torch.manual_seed(0)
    with torch.no_grad():
        return float(loss_of(model, batch))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--environment", default="pusher")
    parser.add_argument("--repeats", type=int, default=9)
    given: Any = parser.parse_args()
    as_a_worker()
    data = observe(given.environment, BATCH)
    for size, config in SIZES.items():
        print(f"\n{size} size, {given.environment}, batch {BATCH}, horizon {data.horizon}")
        for name in MODELS:
            ratios = measure(name, config, data, given.repeats)
            if "torch.nn" in ratios:
                print(f"    of torch.nn, {verdict(ratios['torch.nn'], PLAIN_TARGET)}", end="")
                print(f"; of the limit, {verdict(ratios['float32 limit'], LIMIT_TARGET)}")
            if "mbrl" in ratios:
                print(f"    of mbrl, {verdict(ratios['mbrl'], MBRL_TARGET)}")
    if not has_bfloat16():
        print("\nno bfloat16: this processor has no instructions for it")
    if not has_mbrl():
        print("\nno mbrl: it is not installed; the first lines of this script say how")


if __name__ == "__main__":
    main()
