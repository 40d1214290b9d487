"""The page about environments: its facts, and the committed page against the code."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from study.common.progress import Progress
from study.common.seeds import derive
from study.data.trajectories import ScenarioSet, concatenate
from study.envs import simulator as simulator_module
from study.envs import simulators
from study.envs.card.facts import measure, rows
from study.envs.card.page import OF_THE_STUDY, describe, introduction, tables
from study.envs.card.symmetries import symmetries
from study.envs.observe import observe_scenarios
from study.examples.cart import Cart
from tests.helpers.running import study

PAGE = Path(simulator_module.__file__).with_name("README.md")


def cart(scenarios: int = 20, rollouts: int = 30) -> ScenarioSet:
    return concatenate(observe_scenarios(Cart(), scenarios, rollouts, 3, Progress()))


def test_the_facts() -> None:
    scenarios = cart()
    facts = measure(Cart(), scenarios)
    success = Cart().outcome(scenarios.observed, scenarios.goal[:, None])
    p = success.mean(axis=1)
    assert facts.base_rate == pytest.approx(success.mean())
    assert facts.uncertain == pytest.approx(((p > 0.1) & (p < 0.9)).mean())
    # The oracle: each rollout of a scenario against the share of the other rollouts.
    k = success.shape[1]
    others = (success.sum(axis=1, keepdims=True) - success) / (k - 1)
    cross = ((others - success) ** 2).mean() * (k - 1) / k
    assert facts.oracle == pytest.approx(cross, rel=1e-9)
    nominal = Cart().rollout(scenarios.s0, scenarios.actions).states
    assert facts.nominal == Cart().outcome(nominal[:, 1:], scenarios.goal).mean()
    assert (facts.scenarios, facts.rollouts, facts.events) == (20, 30, ())


def test_events_are_counted_over_rollouts_and_scenarios() -> None:
    simulator = simulators["pusher"](horizon=70)
    scenarios = concatenate(observe_scenarios(simulator, 6, 5, 1, Progress()))
    events = {event.name: event for event in measure(simulator, scenarios).events}
    moved = (scenarios.observed[..., 10:12] != 0).any(axis=(-1, -2))
    missed = events["the ball is missed"]
    assert missed.share == pytest.approx((~moved).mean())
    assert missed.scenarios == (~moved).any(axis=1).sum()
    names = ("the ball is hit squarely", "the ball is grazed", "the ball is missed")
    assert sum(events[name].share for name in names) == pytest.approx(1)


@pytest.mark.slow
def test_the_command_writes_a_page_with_its_pictures(tmp_path: Path) -> None:
    smoke = ("--config", "configs/smoke.yaml", "--plugins=[study.examples.cart]")
    done = study("portrait", "cart", *smoke, "--to", tmp_path)
    assert done.code == 0, done
    text = (tmp_path / "README.md").read_text()
    assert "study/Cart-v0" in text
    assert describe(Cart()) in text
    assert "| mass | kg | mass | 0.5 | 1.5 |" in text
    assert "| target | m | position that the cart has to reach | – | – |" in text
    assert "| goal radius | 0.2 | m |" in text
    assert "| mirror | −x, −v | −force | −target |" in text
    for picture in ("filmstrip", "fans", "histogram"):
        assert f"(pictures/cart_{picture}.png)" in text
        assert (tmp_path / "pictures" / f"cart_{picture}.png").stat().st_size > 1000
    assert "unknown environment 'cartt'" in study("portrait", "cartt", *smoke).err
    assert OF_THE_STUDY.strip().splitlines()[0] not in text
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8")
    assert process.returncode == 0, process.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pusher", "uav"])
def test_the_committed_page_is_of_this_code(name: str) -> None:
    """Text and tables are those of the code; the facts are reproduced with fewer rollouts."""
    page, cls = PAGE.read_text(), simulators[name]
    assert page.startswith(introduction(["pusher", "uav"]))
    section = page[page.index(f"## {cls.title}\n") :].split("\n## ")[0]
    assert describe(cls()) in section
    assert tables(cls()) in section
    # The largest differences depend on the rounding of a machine.
    differences = re.compile(r"\| [\d.e-]+ \| (\d+ \|)$", re.MULTILINE)
    assert differences.sub(r"| \1", symmetries(cls())) in differences.sub(r"| \1", section)
    seed = derive(derive(name, 0), "test")
    scenarios = concatenate(observe_scenarios(cls(threads=2), 250, 16, seed, Progress()))
    facts = measure(cls(), scenarios)
    written = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", section, re.MULTILINE))
    quantities = [quantity for quantity, _ in rows(facts)]
    assert set(quantities) <= written.keys()
    _, _, nominal, base_rate, _, oracle, *_ = quantities
    # Rollouts of one scenario: a standard error of at most 0.5 / √16 each, 250 of them.
    assert float(written[base_rate]) == pytest.approx(facts.base_rate, abs=4 * 0.125 / 250**0.5)
    assert float(written[oracle]) == pytest.approx(facts.oracle, abs=0.01)
    assert written[nominal] == f"{facts.nominal:.1%}"
    # The environments are designed to have uncertain outcomes.
    assert 0.4 < facts.base_rate < 0.6
    assert facts.uncertain > 0.5
    assert facts.nominal >= 0.8
