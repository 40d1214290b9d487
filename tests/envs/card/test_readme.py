"""The page about environments: what it says is so, and the committed one says it of this code."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest

from study.common.progress import Progress
from study.common.seeds import derive
from study.data.trajectories import ScenarioSet, joined
from study.envs import simulator as simulator_module
from study.envs import simulators
from study.envs.card.facts import facts, rows
from study.envs.observe import observe_scenarios
from study.examples.cart import Cart
from tests.helpers.running import study

PAGE = Path(simulator_module.__file__).with_name("README.md")


def cart(scenarios: int = 20, rollouts: int = 30) -> ScenarioSet:
    return joined(observe_scenarios(Cart(), scenarios, rollouts, 3, Progress()))


def test_facts_are_what_they_say() -> None:
    observed = cart()
    measured = facts(Cart(), observed)
    success = Cart().outcome(observed.observed, observed.goal[:, None])
    p = success.mean(axis=1)
    assert measured.base_rate == pytest.approx(success.mean())
    assert measured.uncertain == pytest.approx(((p > 0.1) & (p < 0.9)).mean())
    # The oracle: each rollout of a scenario against the share of the other rollouts.
    others = (success.sum(axis=1, keepdims=True) - success) / (success.shape[1] - 1)
    k = success.shape[1]
    cross = ((others - success) ** 2).mean() * (k - 1) / k
    assert measured.oracle == pytest.approx(cross, rel=1e-9)
    nominal = Cart().rollout(observed.s0, observed.actions).states
    assert measured.nominal == Cart().outcome(nominal[:, 1:], observed.goal).mean()
    assert (measured.scenarios, measured.rollouts, measured.events) == (20, 30, ())


def test_events_are_counted_over_rollouts_and_scenarios() -> None:
    simulator = simulators["pusher"](horizon=70)
    observed = joined(observe_scenarios(simulator, 6, 5, 1, Progress()))
    measured = {event.name: event for event in facts(simulator, observed).events}
    moved = (observed.observed[..., 10:12] != 0).any(axis=(-1, -2))
    missed = measured["the ball is missed"]
    assert missed.share == pytest.approx((~moved).mean())
    assert missed.scenarios == (~moved).any(axis=1).sum()
    how = ("the ball is hit squarely", "the ball is grazed", "the ball is missed")
    assert sum(measured[name].share for name in how) == pytest.approx(1)


def test_the_command_writes_a_page_with_its_pictures(tmp_path: Path) -> None:
    smoke = ("--config", "configs/smoke.yaml", "--plugins=[study.examples.cart]")
    done = study("portrait", "cart", *smoke, "--to", tmp_path)
    assert done.code == 0, done
    text = (tmp_path / "README.md").read_text()
    assert "study/Cart-v0" in text
    assert (inspect.getdoc(Cart) or "?") in text
    for picture in ("filmstrip", "fans", "histogram"):
        assert f"(pictures/cart_{picture}.png)" in text
        assert (tmp_path / "pictures" / f"cart_{picture}.png").stat().st_size > 1000
    assert study("portrait", "cartt", *smoke).err.startswith("error: unknown environment 'cartt'")


@pytest.mark.parametrize("name", ["pusher", "uav"])
def test_the_committed_page_is_of_this_code(name: str) -> None:
    """Its tables are the docstring's; its numbers are found again with fewer rollouts."""
    text = PAGE.read_text()
    cls = simulators[name]
    assert (inspect.getdoc(cls) or "") in text
    section = text[text.index(f"## {cls.title}:") :].split("\n## ")[0]
    rollouts = 16
    seed = derive(derive(name, 0), "test")
    observed = joined(observe_scenarios(cls(threads=2), 250, rollouts, seed, Progress()))
    measured = facts(cls(), observed)
    assert "not Gaussian" in section
    written = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", section, re.MULTILINE))
    base_rate = "base rate: rollouts that succeed"
    # Rollouts of one scenario: a standard error of at most 0.5 / √16 each, 250 of them.
    assert float(written[base_rate]) == pytest.approx(measured.base_rate, abs=4 * 0.125 / 250**0.5)
    assert float(written[rows(measured)[4][0]]) == pytest.approx(measured.oracle, abs=0.01)
    assert written[rows(measured)[1][0]] == f"{measured.nominal:.1%}"
    # What the scenarios were made to be, over the test set.
    assert 0.4 < measured.base_rate < 0.6
    assert np.mean(measured.uncertain) > 0.5
    assert measured.nominal >= 0.8
